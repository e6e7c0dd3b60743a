"""Method dlg-gs: off it is scaffold-gs, on it learns light; continued and stored to the bit."""

import json
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.other_process import shown_elsewhere
from helpers.stored_sizes import bytes_of_tensors, numbers_of_layers
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.methods.anchors.control import AnchorDensity
from splatproof.methods.contracts.reconstruction import Adapts, Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dlg_gs.cost import cost
from splatproof.methods.dlg_gs.fit import fit
from splatproof.methods.dlg_gs.model import INPUTS
from splatproof.methods.dlg_gs.settings import Rates, Settings
from splatproof.methods.models.decoded import AdaptingModel, DecodedModel
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import get_method
from splatproof.methods.scaffold import fit as scaffold
from splatproof.methods.scaffold import settings as scaffold_settings
from splatproof.methods.scaffold.cost import cost as scaffold_cost
from splatproof.reference.types.scene import DepthPrior, Scene, View

DENSITY = AnchorDensity(
    start=0, adjust_start=0, interval=10, least_interval=10, stop=30_000, gradient=1e-4
)
SHORT = Settings(iterations=60, k=4, features=8, head=8, density=DENSITY)
OFF = replace(
    SHORT, vdjc="off", dlaam="off", dropout=0.0, volume=0.01, volume_rule="mean", rates=Rates()
)  # fmt: skip
RUN = Run(threads=1, seed=3)


class Killed(Exception):
    """Stands for a kill between two steps."""


def lit_scene() -> Scene:
    """The tiny scene with priors, seen from two places by turns, by a light that changes in between.

    Odd views are bright, even ones dark; direction and light say nothing of one another.
    """
    scene = tiny_scene()

    def lit(index: int) -> Tensor:
        return scene.views[index // 2].load() * (0.9 if index % 2 else 0.3)

    def prior() -> DepthPrior:
        disparity = torch.arange(18 * 24).reshape(18, 24) / 100
        return DepthPrior(disparity=disparity, valid=torch.ones(18, 24, dtype=torch.bool))

    def seen(index: int, view: View) -> View:
        camera = scene.views[index // 2].camera
        view = replace(view, camera=camera, load=partial(lit, index))
        return replace(view, load_prior=prior) if index in scene.train else view

    views = tuple(seen(index, view) for index, view in enumerate(scene.views))
    return replace(scene, views=views)


@pytest.fixture(scope="module")
def trained() -> DecodedModel:
    return fit(lit_scene(), SHORT, RUN)


@torch.no_grad()
def error(model: DecodedModel, scene: Scene) -> float:
    """Squared error over the training views, each in its own light."""
    views = scene.train_views
    return sum(float((model.render(v).colour - v.load()).square().mean()) for v in views)


def test_with_everything_off_it_is_scaffold_gs_to_the_bit():
    own = fit(tiny_scene(), OFF, RUN)
    given: dict[str, Any] = {n: getattr(OFF, n) for n in vars(scaffold_settings.Settings())}
    given["rates"] = scaffold_settings.Rates()
    other = scaffold.fit(tiny_scene(), scaffold_settings.Settings(**given), RUN)
    want, found = (m.model.parameters.state() for m in (other, own))
    assert want.keys() == found.keys()
    assert all(torch.equal(want[name], found[name]) for name in want)
    assert not isinstance(own, Adapts)


@pytest.fixture(scope="module")
def lit() -> DecodedModel:
    """What has learnt light, by steps that are larger than they would be in a run of full length."""
    quick = replace(
        SHORT, iterations=150, vdjc="off", dropout=0.0, rates=Rates(light=0.02, light_final=4e-3),
        density=AnchorDensity(levels=0, least_opacity=0.0),
    )  # fmt: skip
    return fit(lit_scene(), quick, RUN)


def test_it_learns_light_that_scaffold_gs_cannot_know(lit):
    still = replace(OFF, iterations=150, density=AnchorDensity(levels=0, least_opacity=0.0))
    off = fit(lit_scene(), still, RUN)
    assert error(lit, lit_scene()) < 0.5 * error(off, lit_scene())


def test_a_training_view_that_sees_no_anchor_says_nothing():
    scene = lit_scene()
    behind = torch.diag(torch.tensor([-1.0, 1, -1, 1], dtype=torch.float64))
    turned = replace(
        scene.views[2].camera, world_to_camera=behind @ scene.views[2].camera.world_to_camera
    )
    views = [*scene.views]
    views[2] = replace(views[2], camera=turned)
    found = fit(replace(scene, views=tuple(views)), replace(SHORT, iterations=10), RUN)
    assert all(value.isfinite().all() for value in found.model.parameters.rows.values())
    assert found.render(scene.views[1]).alpha.any()
    assert not found.render(views[2]).alpha.any()


def test_anchors_grew_went_and_moved(trained):
    parameters = trained.model.parameters
    assert (parameters.labels["levels"] >= 0).any()
    own = parameters.labels["levels"] < 0
    still = scaffold.prepare(lit_scene(), OFF, RUN)[0].parameters.labels["centres"]
    apart = torch.cdist(parameters.rows["centres"][own].detach(), still).amin(dim=1)
    assert 0 < float(apart.max()) < 0.1


@pytest.mark.parametrize("step", [30, pytest.param(47, marks=pytest.mark.slow)])
def test_killed_and_continued_is_the_same_to_the_bit(trained, tmp_path, step):
    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= step:
            raise Killed

    cut = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(lit_scene(), SHORT, replace(cut, report=kill))
    again = fit(lit_scene(), SHORT, cut)
    want, found = (m.model.parameters.state() for m in (trained, again))
    assert want.keys() == found.keys()
    assert all(torch.equal(want[name], found[name]) for name in want)


def test_saved_and_rendered_in_another_process(trained, tmp_path):
    save_model(trained, tmp_path / "model", Origin())
    found = shown_elsewhere(tmp_path / "model", tiny_scene, 0, appearance="4.png")
    view = replace(tiny_scene().views[0], appearance="4.png")
    assert np.array_equal(found["colour"], trained.render(view).colour)


def test_only_anchors_and_networks_are_stored(trained, tmp_path):
    save_model(trained, tmp_path, Origin())
    anchor = 3 + 4 * 3 + 8 + 6  # centre, offsets, features, scales
    networks = sum(numbers_of_layers(8 + 3, 8, 4 * each) for each in (1, 7, 3))
    photos = 5 * 12 + 12 * 8  # statistics of each training photo, and the layer that reads them
    attention = 1 + 3 + 3 * INPUTS**2
    light = photos + attention + numbers_of_layers(3 + 8 + INPUTS, 8, 8, 4)
    levels = 8 * trained.primitives  # whole numbers of 8 bytes
    wanted = 4 * (trained.primitives * anchor + networks + light) + levels
    assert bytes_of_tensors(tmp_path) == wanted


@pytest.mark.parametrize(
    "chosen", [OFF, replace(SHORT, dlaam="gates", factor="learnt"), replace(SHORT, exposure="gain")]
)
def test_every_kind_is_loaded_as_it_was_saved(tmp_path, chosen):
    model = fit(lit_scene(), replace(chosen, iterations=5), RUN)
    stored = model.store(tmp_path)
    facts = json.loads(json.dumps(stored.facts))
    again = get_method("dlg-gs").loaders["dlg-gs"](tmp_path, replace(stored, facts=facts), "cpu")
    view = lit_scene().views[0]
    assert torch.equal(again.render(view).colour, model.render(view).colour)


def test_a_damaged_model_is_refused_in_one_line(trained, tmp_path):
    stored = trained.store(tmp_path)
    load = get_method("dlg-gs").loaders["dlg-gs"]
    tensors = {n: v for n, v in stored.tensors.items() if not n.startswith("shared.head.")}
    with pytest.raises(DataError, match=r"model.json: damaged \(KeyError\('head.weight0'\)\)"):
        load(tmp_path, replace(stored, tensors=tensors), "cpu")


def test_a_view_is_shown_in_the_light_that_is_asked_for(lit):
    held_out = lit_scene().views[0]
    dark, bright = (
        lit.render(replace(held_out, appearance=name)).colour.mean() for name in ("4.png", "5.png")
    )
    assert bright > 2 * dark  # it is 3 times as bright


def test_light_is_fitted_to_half_an_image(lit):
    scene = lit_scene()
    view = scene.views[4]
    assert isinstance(lit, AdaptingModel)
    code = lit.fit_appearance(view.without_truth(), view.load()[:, :12], slice(0, 12))
    named = replace(view.without_truth(), name="unknown")

    def off(appearance: Tensor | None) -> float:
        image = lit.render(replace(named, appearance=appearance)).colour
        return float((image - view.load())[:, 12:].square().mean())

    assert off(code) < 0.5 * off(None)


def test_baked_at_a_view_it_looks_the_same_there(trained):
    view = replace(lit_scene().views[0], appearance="5.png")
    explicit = ExplicitModel(model=trained.bake(view), shift=trained.shift, units=trained.units)
    baked = explicit.render(view).colour
    torch.testing.assert_close(baked, trained.render(view).colour, atol=2e-4, rtol=0)
    assert trained.unbaked == ()


def test_without_priors_it_says_what_does_without():
    with pytest.raises(
        UsageError, match=r"view 1.png has no depth prior.*--depth-prior.*--vdjc off"
    ):
        fit(tiny_scene(), SHORT, RUN)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"radius": -1.0}, "radius is -1.0, expected >= 0"),
        ({"depth_final": 0.0}, r"depth_final is 0.0, expected \(0, 1\]"),
        ({"dropout_share": 1.0}, r"dropout_share is 1.0, expected \[0, 1\)"),
        ({"factor_width": 0}, "factor_width is 0, expected >= 1"),
        ({"k": 0}, "k is 0, expected >= 1"),
    ],
)
def test_settings_that_no_run_can_follow_are_refused(given, told):
    with pytest.raises(UsageError, match=told):
        Settings(**given)


def test_cost_grows_with_what_is_on():
    scene = tiny_scene()
    most, some, none = (
        cost(each, scene).cpu_seconds for each in (SHORT, replace(SHORT, vdjc="off"), OFF)
    )
    assert most > some > none
    assert none == scaffold_cost(OFF, scene).cpu_seconds
