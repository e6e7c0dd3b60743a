"""Method dpgs: bits of a continued run, off means 3dgs, and that side views are trained on."""

from dataclasses import replace
from functools import partial

import pytest
import torch

from helpers.baking import baked
from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.fit import fit
from splatproof.methods.dpgs.refiners import refiner_of
from splatproof.methods.dpgs.settings import Dpgs, SideSettings
from splatproof.methods.dpgs.side_training import with_side_views
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.models.exposure import TENSOR, ExposedGaussians, exposed
from splatproof.methods.registry import get_method
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.reference.supervision.spiral_path import SpiralSettings
from splatproof.reference.types.scene import View

DENSITY = Density(start=0, interval=10, least_interval=10, stop=10_000, gradient=1e-5,
                  reset_interval=0)  # fmt: skip
SIDE = SideSettings(every=3, refresh=7500, spiral=SpiralSettings(layers=2, views=3))
SHORT = Dpgs(iterations=40, sh_degree=1, density=DENSITY, side=SIDE)
RUN = Run(threads=1, seed=3)


def scene():
    """The row of cameras is above the cube: up is against their axes."""
    return replace(tiny_scene(), up=torch.tensor([0.0, 0, -1], dtype=torch.float64))


class Killed(Exception):
    pass


@pytest.mark.parametrize("step", [pytest.param(10, marks=pytest.mark.slow), 30])
def test_killed_and_continued_is_the_same_to_the_bit(tmp_path, step):
    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= step:
            raise Killed

    cut = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(scene(), SHORT, replace(cut, report=kill))
    again, whole = (baked(fit(scene(), SHORT, run)) for run in (cut, RUN))
    assert all(torch.equal(getattr(again, name), getattr(whole, name)) for name in FIELDS)


def test_a_killed_run_may_have_made_a_round_that_its_checkpoint_does_not_know(tmp_path):
    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= 30:
            raise Killed

    seldom = replace(RUN, folder=tmp_path, checkpoint_seconds=1e9)
    with pytest.raises(Killed):
        fit(scene(), SHORT, replace(seldom, report=kill))
    assert list((tmp_path / "checkpoint" / "side").rglob("*.safetensors"))
    again, whole = (baked(fit(scene(), SHORT, run)) for run in (seldom, RUN))
    assert all(torch.equal(getattr(again, name), getattr(whole, name)) for name in FIELDS)


def test_with_its_parts_off_it_is_3dgs():
    off = replace(SHORT, dense_cell=0.0, side=SideSettings(every=0))
    plain = Settings(iterations=40, sh_degree=1, density=DENSITY)
    one, other = fit(scene(), off, RUN), get_method("3dgs").fit(scene(), plain, RUN)
    assert all(torch.equal(getattr(baked(one), n), getattr(baked(other), n)) for n in FIELDS)


def test_side_views_change_the_model_and_the_record_says_how_many_there_were():
    facts, solid = {}, replace(SHORT, initial_opacity=0.9)  # haze has no surface to warp onto
    models = [
        baked(fit(scene(), replace(solid, side=side), replace(RUN, on_fact=facts.__setitem__)))
        for side in (SIDE, SideSettings(every=0), replace(SIDE, refiner="none"))
    ]
    assert facts["side views"] == "6 on 1 spirals, none"
    assert 0 < float(facts["side pixels trained on, round 1"]) <= 1
    assert facts["gradients by"] == "kernels"
    sh = [model.sh for model in models]
    assert not any(torch.equal(a, b) for a, b in ((sh[0], sh[1]), (sh[1], sh[2]), (sh[0], sh[2])))


def test_exposures_are_those_of_photos():
    fitted = fit(scene(), replace(SHORT, exposure="gain"), RUN)
    names = [view.name for view in scene().train_views]
    assert isinstance(fitted, ExposedGaussians)
    assert list(fitted.exposures.photos) == names


def test_targets_are_in_the_exposure_of_renders_whatever_photos_have():
    """Photos with planted gains, which the model has learnt, give the targets of photos without."""
    gains = torch.tensor([0.2, -0.3, 0.1, 0.15, -0.15])
    plain = [replace(v, load=partial(torch.mul, v.load(), 0.5)) for v in scene().train_views]
    lit = [
        replace(v, load=partial(torch.mul, v.load(), float(gain.exp())))
        for v, gain in zip(plain, gains, strict=True)
    ]

    def targets(photos: list[View], learnt: torch.Tensor) -> torch.Tensor:
        shown = replace(scene(), views=tuple(photos), train=(0, 1, 2, 3, 4), test=())
        settings = replace(SHORT, initial_opacity=0.9, dense_cell=0.0)
        model, plan = threedgs.prepare(shown, settings, RUN)
        whole = exposed(model, "gain", plan.views)
        whole.parameters.shared[TENSOR] = learnt[:, None].expand(5, 3).clone()
        sided = with_side_views(
            [camera(2)], shown, whole, plan, settings.side, refiner_of(settings.side), RUN
        )
        return sided.views[5].load()

    want = targets(plain, torch.zeros(5))
    found = targets(lit, gains)
    assert float((found - want).abs().max()) < 1.5 / 255
    assert float((targets(lit, torch.zeros(5)) - want).abs().max()) > 5 / 255


def test_another_setting_finds_no_rounds_of_the_last(tmp_path):
    run = replace(RUN, folder=tmp_path)
    fit(scene(), SHORT, run)
    with pytest.raises(UsageError, match="belongs to a run that differs"):
        fit(scene(), replace(SHORT, side=replace(SIDE, refiner="none")), run)
    (tmp_path / "checkpoint" / "training.safetensors").unlink()
    other = replace(SHORT, side=replace(SIDE, refiner="none"))
    again, whole = (baked(fit(scene(), other, one)) for one in (run, RUN))
    assert torch.equal(again.sh, whole.sh)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"every": -1}, "side.every is -1, expected >= 0"),
        ({"spirals": 0}, "side.spirals is 0, expected >= 1"),
        ({"spiral": SpiralSettings(views=0)}, "side.spiral.views is 0, expected >= 1"),
        ({"spiral": SpiralSettings(radius=0.9)}, "side.spiral.radius is 0.9, expected 1 or more"),
        ({"spiral": SpiralSettings(radius=float("inf"))}, "side.spiral.radius is inf, expected 1"),
        ({"spiral": SpiralSettings(look_up=1.0)}, r"side.spiral.look_up is 1.0, expected \[0, 1\)"),
    ],
)
def test_bad_settings_are_refused(given, said):
    with pytest.raises(UsageError, match=said):
        SideSettings(**given)
