"""Gaussians that swing and fade: where they are when, what is drawn, and that stillness is 3dgs."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from helpers.tiny_scene import camera, random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.model import TRAINED, Moment
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.settings import SkySettings
from splatproof.methods.dynamic.sky import SKY, started
from splatproof.methods.dynamic.smoothing import average_velocities
from splatproof.methods.dynamic.times import Clock
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.pvg.fit import schedules
from splatproof.methods.pvg.model import ROWS, VibrationModel, restored
from splatproof.methods.pvg.settings import Motion, MovingRates, Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.density_control import DensityControl
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import Rates
from splatproof.methods.training.terms import Photometric
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View, camera_view

CLOCK = Clock(middle=1.0, second=0.2, duration=0.2)
STILL = Motion(smoothing=0.0)


def model(count: int = 12, motion: Motion = STILL, *, sky: int = 0, rates=None, **values: Any):
    one = random_gaussians(count)
    generator = torch.Generator().manual_seed(7)
    rows = {
        "means": one.means, "sh_dc": one.sh[:, :1], "sh_rest": one.sh[:, 1:],
        "opacity_logits": one.opacity_logits, "log_scales": one.log_scales,
        "quaternions": one.quaternions,
        "peaks": 0.1 * torch.randn(count, generator=generator),
        "log_spans": torch.full((count,), 0.05).log(),
        "velocities": torch.randn(count, 3, generator=generator),
    } | values  # fmt: skip
    parameters = Parameters(rows, shared=started(SkySettings(resolution=sky)))
    settings = Settings(iterations=20, rates=rates or MovingRates())
    return VibrationModel(
        parameters, schedules(settings, 1.0, [*parameters.trained]), clock=CLOCK, motion=motion
    )


def at(time: float) -> View:
    """A view at a model time."""
    return camera_view(camera(0), time=CLOCK.middle + time / CLOCK.second)


def every(**more) -> Motion:
    return replace(STILL, least_life=0.0, **more)


def test_where_they_are_and_how_opaque():
    ours, time = model(motion=every()), 0.03
    rows, splats = ours.parameters.rows, ours.splats(at(time), TRAINED)
    away = time - rows["peaks"]
    swing = 0.2 / (2 * math.pi) * torch.sin(2 * math.pi * away / 0.2)
    torch.testing.assert_close(splats.means, rows["means"] + swing[:, None] * rows["velocities"])
    fade = torch.exp(-0.5 * (away / 0.05) ** 2)
    torch.testing.assert_close(splats.opacities, torch.sigmoid(rows["opacity_logits"]) * fade)


def test_at_its_peak_a_gaussian_is_at_its_centre_whole_and_moves_with_its_velocity():
    ours = model(motion=every(), peaks=torch.full((12,), 0.04))
    rows = ours.parameters.rows
    before, now, after = (ours.splats(at(0.04 + d), TRAINED) for d in (-1e-3, 0.0, 1e-3))
    torch.testing.assert_close(now.means, rows["means"], atol=1e-6, rtol=0)
    torch.testing.assert_close(now.opacities, rows["opacity_logits"].sigmoid())
    slope = (after.means - before.means) / 2e-3
    torch.testing.assert_close(slope, rows["velocities"], atol=2e-3, rtol=2e-3)


def test_what_does_not_live_is_left_out_and_rows_say_who_is_drawn():
    ours = model(motion=replace(STILL, least_life=0.05))
    whole = model(motion=every()).splats(at(0.1), TRAINED)
    rows = ours.parameters.rows
    alive = torch.exp(-0.5 * ((0.1 - rows["peaks"]) / 0.05) ** 2) > 0.05
    assert 0 < int(alive.sum()) < 12
    splats = ours.splats(at(0.1), TRAINED)
    assert splats.rows is not None
    assert torch.equal(splats.rows, torch.where(alive)[0])
    assert splats.sh is not None
    assert whole.sh is not None
    for name in ("means", "quaternions", "scales", "opacities", "sh"):
        assert torch.equal(getattr(splats, name), getattr(whole, name)[alive])


def test_of_nothing_that_lives_nothing_is_drawn():
    splats = model().splats(at(5.0), TRAINED)
    assert len(splats) == 0


def test_without_motion_life_and_sky_it_trains_as_3dgs_does_to_the_bit():
    scene, count = tiny_scene(), 20
    views = tuple(replace(v, time=0.1 * i) for i, v in enumerate(scene.train_views))
    frozen = MovingRates(velocities=0.0, peaks=0.0, log_spans=0.0)
    ours = model(
        count, rates=frozen, velocities=torch.zeros(count, 3),
        log_spans=torch.full((count,), math.inf),
    )  # fmt: skip
    theirs = GaussianModel(random_gaussians(count), Rates(), extent=1.0)
    density = Density(start=0, interval=5, least_interval=5, gradient=1e-6, reset_interval=12)
    for one in (ours, theirs):
        plan = Plan(
            steps=20, views=views, terms=(Photometric(),), key="", native=False,
            density=DensityControl(density, iterations=30_000, extent=1.0),
        )  # fmt: skip
        Trainer(one, plan, Run(threads=1, seed=2)).train()
    assert len(theirs.parameters) != count
    for name, value in theirs.parameters.rows.items():
        assert torch.equal(value.detach(), ours.parameters.rows[name].detach()), name


def test_a_smoothed_step_draws_another_moment_moved_on():
    motion = every(smoothing=1.0, reach=0.03)
    ours, generator = model(motion=motion), torch.Generator().manual_seed(11)
    _, place = torch.rand(2, generator=torch.Generator().manual_seed(11)).tolist()
    later = (2 * place - 1) * 0.03
    splats = ours.splats(at(0.02), Moment(step=1, total=9, generator=generator))
    then = model(motion=every()).splats(at(0.02 - later), TRAINED)
    rows = ours.parameters.rows
    slow = average_velocities(rows["velocities"], rows["log_spans"].exp(), 0.2, 1.0)
    torch.testing.assert_close(splats.means, then.means + slow * later)
    torch.testing.assert_close(splats.opacities, then.opacities)
    share = math.exp(-0.05 / (2 * 0.2))
    torch.testing.assert_close(slow, ours.parameters.rows["velocities"] * share)


def test_the_sky_is_behind_it_and_its_gradient_reaches_the_texels():
    ours = model(sky=4)
    colour = torch.zeros(18, 24, 3)
    output = RenderOutput(
        colour=colour, alpha=torch.full((18, 24), 0.25), depth=colour[..., 0], radii=colour[0, 0]
    )
    image = ours.finish_image(at(0.0), output)
    torch.testing.assert_close(image, torch.full((18, 24, 3), 0.75 * 0.5))
    assert ours.finishes
    assert SKY in ours.schedules
    assert ours.unbaked == ("its sky",)
    assert model().unbaked == ()


@pytest.mark.parametrize(
    "values",
    [
        {"log_spans": torch.full((12,), -math.inf)},
        {"log_spans": torch.full((12,), -50.0), "peaks": torch.full((12,), 0.03)},
        {"log_spans": torch.full((12,), 80.0)},
        {"velocities": torch.full((12, 3), 1e6)},
    ],
)
def test_extreme_lives_and_speeds_leave_everything_finite(values):
    for motion in (every(), STILL, every(period=1e-3, smoothing=1.0)):
        ours = model(motion=motion, **values)
        rows = ours.parameters.rows
        for value in rows.values():
            value.requires_grad_()
        moment = Moment(step=3, total=9, generator=torch.Generator().manual_seed(0))
        splats = ours.splats(at(0.03), moment)
        (splats.means.square().sum() + splats.opacities.sum()).backward()
        assert all(
            bool(value.grad is None or value.grad.isfinite().all()) for value in rows.values()
        )
        bound = motion.period / (2 * math.pi) * rows["velocities"].norm(dim=1)
        bound = bound + motion.reach * rows["velocities"].norm(dim=1) * (motion.smoothing > 0)
        if len(splats) == 12:
            away = (splats.means - rows["means"]).norm(dim=1)
            assert bool((away <= bound * (1 + 1e-4) + 1e-4).all())


def test_a_view_without_time_is_refused():
    with pytest.raises(UsageError, match="view 'somewhere': has no time"):
        model().splats(camera_view(camera(0), "somewhere"), TRAINED)


def test_bands_of_harmonics_come_with_the_steps():
    ours = model(motion=every())
    ours.sh_every = 10.0
    generator = torch.Generator().manual_seed(0)
    early = ours.splats(at(0.0), Moment(step=5, total=20, generator=generator))
    assert early.sh is not None
    assert early.sh.shape[1] == 1
    late = ours.splats(at(0.0), TRAINED)
    assert late.sh is not None
    assert late.sh.shape[1] == 4


def test_it_is_made_again_of_what_is_stored():
    ours = model(sky=3, motion=Motion(period=0.3, least_life=0.01))
    again = restored(ours.facts(), ours.parameters.state())
    splats, other = (one.splats(at(0.05), TRAINED) for one in (ours, again))
    assert torch.equal(splats.means, other.means)
    assert torch.equal(splats.opacities, other.opacities)
    assert again.facts() == ours.facts()


@pytest.mark.parametrize("name", ROWS)
def test_a_missing_tensor_is_a_key_error_and_one_of_another_shape_a_value_error(name):
    ours = model()
    state = ours.parameters.state()
    bent = state | {f"rows.{name}": torch.zeros(12, 7, 2)}
    with pytest.raises((ValueError, KeyError)):
        restored(ours.facts(), bent)
    del state[f"rows.{name}"]
    with pytest.raises(KeyError):
        restored(ours.facts(), state)
