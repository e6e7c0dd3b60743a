"""Exposures of photos: recovered where they differ, neutral on average, stored with any model."""

from dataclasses import replace
from functools import partial
from typing import Any

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import DataError
from splatproof.methods.contracts.model import TRAINED
from splatproof.methods.contracts.reconstruction import Adapts, Origin, Reconstruction, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models import exposure
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import (
    NUMBERS,
    ExposedGaussians,
    ExposedModel,
    Exposures,
    adjusted,
    exposed,
)
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.registry import get_method
from splatproof.methods.storage.ply import write_ply
from splatproof.methods.training.schedules import Rates
from splatproof.reference.types.scene import Scene, View
from splatproof.reference.types.splats import Splats

RUN = Run(threads=1, seed=3, background=(0.15, 0.15, 0.15))
STEPS = 240
GAINS = torch.tensor(
    [[0.3, 0.1, -0.2], [-0.3, 0.2, 0.1], [0.2, -0.3, 0.2], [-0.4, -0.1, 0.1], [0.2, 0.1, -0.2]]
)
"""Log gains of the five training photos; their mean is zero."""
MAPS = torch.cat([0.5 * GAINS, torch.zeros(5, 9)], dim=1)[:, [0, 3, 4, 5, 6, 1, 7, 8, 9, 10, 2, 11]]
MAPS[:, [3, 7, 11]] = 0.3 * GAINS.flip(1)
MAPS[:, 1] = 0.2 * GAINS[:, 0]


def lit(codes: Tensor) -> Scene:
    """The tiny scene whose training photos were taken with these exposures."""
    scene = tiny_scene()
    views = list(scene.views)
    for index, code in zip(scene.train, codes, strict=True):
        photo = adjusted(0.15 + 0.4 * views[index].load(), code)
        assert 0 <= float(photo.min()) <= float(photo.max()) <= 1  # nothing is clipped
        views[index] = replace(views[index], load=partial(torch.clone, photo))
    for index in scene.test:
        photo = 0.15 + 0.4 * views[index].load()
        views[index] = replace(views[index], load=partial(torch.clone, photo))
    return replace(scene, views=tuple(views))


def trained(
    method: str, scene: Scene, run: Run = RUN, steps: int = STEPS, **settings
) -> Reconstruction:
    found = get_method(method)
    density = replace(found.settings().density, stop=0)  # none: points are the true centres
    return found.fit(scene, found.settings(iterations=steps, density=density, **settings), run)


def error(model: Reconstruction, view: View) -> float:
    behind = torch.tensor(RUN.background)
    return float((model.render(view, behind).colour - view.load()).square().mean())


@pytest.fixture(scope="module", autouse=True)
def _few_steps_are_long():
    """Gains of 0.4 are not reached in 240 steps at the rates of longer runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exposure, "RATE", 0.01)
        patch.setattr(exposure, "LAST_RATE", 0.001)
        yield


@pytest.fixture(scope="module")
def models() -> dict[str, Any]:
    """By what is learnt; those that learn nothing by what the photos have."""
    return {
        "gain": trained("3dgs", lit(GAINS), exposure="gain"),
        "affine": trained("3dgs", lit(MAPS), exposure="affine"),
        "nothing of gain": trained("3dgs", lit(GAINS)),
        "nothing of affine": trained("3dgs", lit(MAPS)),
    }


def test_codes_are_log_gains_or_rows_of_a_map_beside_the_identity():
    colour = torch.tensor([[[0.5, 0.25, 1.0]]])
    gains = torch.tensor([2.0, 1.0, 0.5]).log()
    torch.testing.assert_close(adjusted(colour, gains), torch.tensor([[[1.0, 0.25, 0.5]]]))
    rows = torch.tensor([0, 1, 0, 0.1, 0, 0, 0, 0.2, 0, 0, -1, 0])
    torch.testing.assert_close(adjusted(colour, rows), torch.tensor([[[0.85, 0.45, 0.0]]]))


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_what_a_photos_exposure_did_is_undone(kind):
    scene, draw = tiny_scene(), torch.Generator().manual_seed(0)
    names = tuple(view.name for view in scene.train_views)
    raw = 0.2 * torch.randn(len(names), NUMBERS[kind], generator=draw)
    known = Exposures(kind=kind, photos=names, raw=raw)
    for view in scene.views:
        again = known.undone(view, known.shown(view, view.load()))
        torch.testing.assert_close(again, view.load(), atol=1e-5, rtol=0)


def test_planted_gains_are_found_again(models):
    torch.testing.assert_close(models["gain"].exposures.codes(), GAINS, atol=0.05, rtol=0)
    wrong = models["gain"].exposures.codes().roll(1, dims=0)
    assert not torch.allclose(wrong, GAINS, atol=0.05, rtol=0)


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_a_scene_of_other_exposures_is_recovered_better_with_them(models, kind):
    """Both what was trained on and what was not, which has a neutral exposure."""
    scene = lit(GAINS if kind == "gain" else MAPS)
    with_them, without = models[kind], models[f"nothing of {kind}"]
    for views in (scene.train_views, scene.test_views):
        assert sum(error(with_them, v) for v in views) < 0.8 * sum(error(without, v) for v in views)


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_exposures_are_neutral_on_average(kind):
    """Photos that are all dark are of a dark scene."""
    raw = torch.randn(7, NUMBERS[kind], generator=torch.Generator().manual_seed(0)) - 3
    exposures = Exposures(kind=kind, photos=tuple("abcdefg"), raw=raw)
    # float32 means of seven numbers of size 4
    torch.testing.assert_close(
        exposures.codes().mean(dim=0), torch.zeros(NUMBERS[kind]), atol=1e-6, rtol=0
    )
    same = replace(exposures, raw=raw[:1].expand(7, -1))
    # the mean of seven equal numbers may differ from them in the last digit
    torch.testing.assert_close(same.codes(), torch.zeros_like(raw), atol=1e-6, rtol=0)
    colour = torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(1))
    assert torch.equal(adjusted(colour, exposures.neutral()), colour)


def test_a_view_is_shown_in_its_own_exposure_the_named_one_the_given_one_or_none(models):
    model = models["gain"]
    codes = model.exposures.codes()
    view = lit(GAINS).test_views[0]
    neutral = model.render(view).colour

    def gain(**changed) -> Tensor:
        colour = model.render(replace(view, **changed)).colour
        return (colour.sum(dim=(0, 1)) / neutral.sum(dim=(0, 1))).log()

    torch.testing.assert_close(gain(name="2.png"), codes[1], atol=1e-4, rtol=0)
    torch.testing.assert_close(gain(appearance="4.png"), codes[3], atol=1e-4, rtol=0)
    torch.testing.assert_close(gain(name="2.png", appearance="4.png"), codes[3], atol=1e-4, rtol=0)
    given = torch.tensor([0.5, 0.0, -0.5])
    torch.testing.assert_close(gain(appearance=given), given, atol=1e-4, rtol=0)
    alone = ExplicitModel(model=model.model)
    assert torch.equal(neutral, alone.render(view).colour)


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_an_exposure_is_fitted_to_half_an_image(models, kind):
    model = models[kind]
    assert isinstance(model, ExposedGaussians)
    assert isinstance(model, Adapts)
    view = lit(GAINS).views[1]
    shown = model.render(replace(view, appearance="5.png")).colour
    left = slice(0, view.camera.width // 2)
    code = model.fit_appearance(replace(view, name="new").without_truth(), shown[:, left], left)
    again = model.render(replace(view, appearance=code)).colour
    # the last rate that is tried is 1/64 of 0.05
    torch.testing.assert_close(again, shown, atol=5e-3, rtol=0)


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_an_exposure_is_fitted_past_a_mask(models, kind):
    model, view = models[kind], lit(GAINS).views[1]
    shown = model.render(replace(view, appearance="5.png")).colour
    mask = torch.ones(view.size, dtype=torch.bool)
    mask[8:] = False  # more than half: the least absolute difference bears less
    white, every = shown.where(mask[..., None], torch.tensor(1.0)), slice(0, view.camera.width)
    code = model.fit_appearance(replace(view, name="new").without_truth(), white, every, mask)
    again = model.render(replace(view, appearance=code)).colour
    # the last rate that is tried is 1/64 of 0.05
    torch.testing.assert_close(again, shown, atol=5e-3, rtol=0)


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_it_is_stored_and_its_gaussians_are_exported_in_neutral_exposure(models, kind, tmp_path):
    model, view = models[kind], lit(GAINS).views[2]
    save_model(model, tmp_path / "model", Origin())
    again = load_reconstruction(tmp_path / "model")
    assert isinstance(again, ExposedGaussians)
    assert torch.equal(model.render(view).colour, again.render(view).colour)
    other = replace(view, appearance="4.png")
    assert torch.equal(model.render(other).colour, again.render(other).colour)
    assert not torch.equal(model.render(view).colour, model.render(other).colour)
    write_ply(tmp_path / "exposed.ply", again.bake(), shift=again.shift)
    write_ply(tmp_path / "plain.ply", model.model, shift=model.shift)
    assert (tmp_path / "exposed.ply").read_bytes() == (tmp_path / "plain.ply").read_bytes()


@pytest.mark.parametrize(("name", "value"), [("shape", torch.zeros(2, 3)), ("nan", None)])
def test_a_damaged_model_is_refused_in_one_line(models, name, value, tmp_path):
    model = models["gain"]
    raw = torch.full_like(model.exposures.raw, torch.nan) if value is None else value
    broken = replace(model, exposures=replace(model.exposures, raw=raw))
    save_model(broken, tmp_path, Origin())
    with pytest.raises(DataError, match=r"photo_exposures (has shape|is not finite)"):
        load_reconstruction(tmp_path)


def test_off_changes_nothing_and_says_that_there_is_none_to_fit(models):
    assert not isinstance(models["nothing of gain"], Adapts)
    model = GaussianModel(random_gaussians(5), Rates(), extent=1.0)
    assert exposed(model, "off", tiny_scene().train_views) is model


@pytest.mark.parametrize(
    ("method", "more"),
    [
        ("absgs", {}),
        ("mip-splatting", {}),
        ("fsgs", {}),
        ("scaffold-gs", {}),
        ("dlg-gs", {"vdjc": "off", "dlaam": "off"}),
    ],
)
def test_every_method_learns_them(method, more, tmp_path):
    facts: dict[str, str] = {}
    run = replace(RUN, on_fact=facts.__setitem__)
    model = trained(method, lit(GAINS), run, exposure="gain", **more)
    assert facts["gradients by"] == "autograd"
    save_model(model, tmp_path, Origin())
    again = load_reconstruction(tmp_path)
    assert isinstance(again, Adapts)
    view = lit(GAINS).views[1]
    names = ("1.png", "4.png")
    first, second = (again.render(replace(view, appearance=name)).colour for name in names)
    assert torch.equal(first, model.render(view).colour)
    brighter = (first.sum(dim=(0, 1)) / second.sum(dim=(0, 1))).log()
    torch.testing.assert_close(brighter, GAINS[0] - GAINS[3], atol=0.15, rtol=0)  # gains: 0.7 apart


class Killed(Exception):
    """Stands for a kill between two steps."""


def test_a_killed_run_is_continued_to_the_bit(tmp_path):
    def report(step: int, total: int, values: dict[str, float]) -> None:
        if step == 20:
            raise Killed

    def raw(run: Run) -> Tensor:
        model = trained("3dgs", lit(GAINS), run, steps=40, exposure="affine")
        assert isinstance(model, ExposedGaussians)
        return torch.cat([model.exposures.raw.flatten(), model.model.means.flatten()])

    run = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        raw(replace(run, report=report))
    assert torch.equal(raw(run), raw(RUN))


def test_one_photo_has_no_exposure_to_compare():
    scene = replace(tiny_scene(), train=(1,))
    with pytest.raises(DataError, match=r"exposure 'gain' with 1 training view.*'off'"):
        trained("3dgs", scene, exposure="gain")


class Coded(GaussianModel):
    """Gaussians whose own code moves them to the right."""

    def neutral_code(self, view: View) -> Tensor:
        return torch.zeros(1)

    def splats(self, view, moment) -> Splats:
        splats = super().splats(view, moment)
        code = view.appearance if isinstance(view.appearance, Tensor) else self.neutral_code(view)
        assert code.shape == (1,)
        return replace(splats, means=splats.means + torch.tensor([1.0, 0, 0]) * code)


def test_the_code_of_a_model_comes_before_that_of_its_exposure():
    scene = tiny_scene()
    base = Coded(random_gaussians(30), Rates(), extent=1.0)
    model = exposed(base, "gain", scene.train_views)
    assert isinstance(model, ExposedModel)
    whole = DecodedModel.of("coded", model, scene, "cpu")
    assert whole.unbaked == ("the exposures of its photos",)
    view = scene.views[0]
    assert torch.equal(model.neutral_code(view), torch.zeros(4))
    code = torch.tensor([0.5, 0.1, 0.2, 0.3])
    asked = replace(view, appearance=code)
    moved = model.splats(asked, TRAINED).means - base.splats(view, TRAINED).means
    torch.testing.assert_close(moved, torch.tensor([[0.5, 0, 0]]).expand(30, 3))
    inner = DecodedModel.of("coded", base, scene, "cpu")
    alone = inner.render(replace(view, appearance=code[:1])).colour
    torch.testing.assert_close(whole.render(asked).colour, alone * code[1:].exp())
