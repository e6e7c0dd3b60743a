"""Method pvg: it learns what moves, is continued to the bit, and lives on in another process."""

from dataclasses import replace
from typing import NoReturn

import numpy as np
import pytest
import torch

from helpers.other_process import shown_elsewhere
from helpers.tiny_drive import moving_pixels, moving_returns, tiny_drive
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.settings import LidarSettings, SkySettings
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.pvg import start
from splatproof.methods.pvg.cost import cost
from splatproof.methods.pvg.fit import fit
from splatproof.methods.pvg.settings import (
    Motion,
    MovingDensity,
    MovingRates,
    Settings,
    Start,
)
from splatproof.methods.storage.ply import read_ply, write_ply
from splatproof.reference.types.scene import Scene

DENSITY = MovingDensity(interval=10, least_interval=10, time_gradient=1e-4)
SHORT = Settings(
    iterations=60, sh_degree=1, density=DENSITY, sky=SkySettings(resolution=4),
    rates=MovingRates(velocities=0.02),
)  # fmt: skip
RUN = Run(threads=1, seed=3)


class Killed(Exception):
    """Stands for a kill between two steps."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return tiny_drive().for_training()


@pytest.fixture(scope="module")
def trained(scene) -> DecodedModel:
    return fit(scene, SHORT, RUN)


def error(model: DecodedModel) -> float:
    """Mean squared error of what moves at the held-out moment."""
    view = tiny_drive().views[3]
    pixels = moving_pixels(view)
    assert 20 < int(pixels.sum()) < 300
    return float((model.render(view).colour - view.load()).square().mean(dim=-1)[pixels].mean())


def test_what_moves_is_learnt_better_in_motion_than_standing_still(scene, monkeypatch):
    monkeypatch.setattr(start, "in_motion", lambda found, up: moving_returns(scene.train_views))
    rates = MovingRates(sh_dc=0.02, quaternions=0.005, log_scales=0.02)
    ours = replace(
        SHORT, iterations=200, rates=rates,
        density=MovingDensity(interval=20, least_interval=20, reset_interval=0),
    )  # fmt: skip
    still = replace(
        ours, rates=replace(rates, velocities=0.0, log_spans=0.0, peaks=0.0),
        start=Start(moving_span=1e4, still_span=1e4, velocities=False),
        motion=Motion(smoothing=0.0),
    )  # fmt: skip
    moves, stays = (error(fit(scene, settings, RUN)) for settings in (ours, still))
    assert moves < 0.8 * stays  # 1 dB; 1.8 were seen


@pytest.mark.parametrize(
    "step", [17, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 45, 59))]
)
def test_killed_and_continued_is_the_same_to_the_bit(scene, trained, tmp_path, step):
    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= step:
            raise Killed

    cut = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(scene, SHORT, replace(cut, report=kill))
    again = fit(scene, SHORT, cut)
    want, found = (m.model.parameters.state() for m in (trained, again))
    assert want.keys() == found.keys()
    assert all(torch.equal(want[name], found[name]) for name in want)


def test_the_terms_are_told_by_name(scene):
    told: list[dict[str, float]] = []
    fit(
        scene,
        replace(SHORT, iterations=1),
        replace(RUN, report=lambda step, total, values: told.append(values)),
    )
    assert told[-1].keys() == {"loss", "lidar", "sky", "photometric", "gaussians"}


def test_other_settings_do_not_continue(scene, tmp_path):
    run = replace(RUN, folder=tmp_path)
    fit(scene, replace(SHORT, iterations=2), run)
    with pytest.raises(UsageError, match="differs: settings.motion.period 0.2 before, 0.3 now"):
        fit(scene, replace(SHORT, iterations=2, motion=Motion(period=0.3)), run)


@pytest.mark.parametrize(
    "more",
    [
        {},
        pytest.param(
            {"antialiased": True, "sky": SkySettings(resolution=0)}, marks=pytest.mark.slow
        ),
    ],
)
def test_saved_and_rendered_in_another_process(scene, tmp_path, more):
    model = fit(scene, replace(SHORT, iterations=12, **more), RUN)
    save_model(model, tmp_path / "model", Origin())
    found = shown_elsewhere(tmp_path / "model", tiny_drive, 3)
    assert np.array_equal(found["colour"], model.render(tiny_drive().views[3]).colour)


def test_what_is_stored_is_what_counts(trained, tmp_path):
    save_model(trained, tmp_path / "model", Origin())
    numbers = 11 + 3 * 4 + 5  # of a Gaussian, its harmonics, its motion
    wanted = 4 * (trained.primitives * numbers + 6 * 4 * 4 * 3)
    size = (tmp_path / "model" / "model.safetensors").stat().st_size
    assert wanted < size < wanted + 2000


def test_baked_at_a_moment_without_sky_it_looks_the_same_there(scene, tmp_path):
    model = fit(scene, replace(SHORT, sky=SkySettings(resolution=0)), RUN)
    view = tiny_drive().views[3]
    write_ply(tmp_path / "m.ply", model.bake(view), model.shift)
    again, _ = read_ply(tmp_path / "m.ply")
    baked = ExplicitModel(model=again, shift=model.shift, units=model.units).render(view).colour
    torch.testing.assert_close(baked, model.render(view).colour, atol=2e-4, rtol=0)
    later = model.render(replace(view, time=0.7)).colour
    assert float((later - model.render(view).colour).abs().amax()) > 0.05
    with pytest.raises(UsageError, match="has no time"):
        model.render(replace(view, time=None))


def without(scene: Scene, **more) -> Scene:
    return replace(scene, views=tuple(replace(view, **more) for view in scene.views))


def test_what_a_scene_lacks_is_said_in_one_line_with_the_setting_that_does_without(scene):
    with pytest.raises(DataError, match="has no time.*static method such as 3dgs"):
        fit(tiny_scene(), SHORT, RUN)
    blind = without(scene, load_sweep=None)
    both = r"LiDAR sweep; set lidar.weight = 0 and start.sweep_points = 0 to"
    with pytest.raises(DataError, match=both):
        fit(blind, SHORT, RUN)
    no_term = replace(SHORT, lidar=LidarSettings(weight=0.0), iterations=2)
    with pytest.raises(DataError, match=r"LiDAR sweep; set start.sweep_points = 0 to"):
        fit(blind, no_term, RUN)
    with pytest.raises(DataError, match=r"LiDAR sweep; set lidar.weight = 0 to"):
        fit(blind, replace(SHORT, start=Start(sweep_points=0)), RUN)
    assert fit(blind, replace(no_term, start=Start(sweep_points=0)), RUN).primitives > 0
    clouded = without(scene, load_sky=None)
    with pytest.raises(DataError, match=r"sky mask; set sky.weight = 0 to"):
        fit(clouded, SHORT, RUN)
    short = replace(SHORT, iterations=2, sky=SkySettings(resolution=4, weight=0.0))
    assert fit(clouded, short, RUN).primitives > 0


def test_truth_is_never_read():
    def forbidden() -> NoReturn:
        raise AssertionError("truth was read")

    drive = without(tiny_drive(), load_depth=forbidden, load_moving=forbidden)
    fit(drive, replace(SHORT, iterations=2), RUN)


def test_a_single_moment_is_trained(scene):
    frozen = without(scene, time=0.5)
    model = fit(frozen, replace(SHORT, iterations=5), RUN)
    assert model.render(frozen.views[0]).colour.isfinite().all()


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Settings(iterations=0), "iterations is 0, expected >= 1"),
        (lambda: Settings(initial_opacity=1.0), "initial_opacity is 1.0, expected between"),
        (lambda: Motion(period=0.0), "motion.period is 0.0, expected > 0"),
        (lambda: Motion(smoothing=1.5), "motion.smoothing is 1.5, expected 0 to 1"),
        (lambda: Motion(least_life=1.0), "motion.least_life is 1.0, expected 0 to below 1"),
        (lambda: Start(sweep_points=-1), "start.sweep_points is -1, expected >= 0"),
        (lambda: Start(moving_span=0.0), "start.moving_span is 0.0, expected > 0"),
        (lambda: MovingRates(peaks=-1.0), "rates.peaks is -1.0, expected >= 0"),
        (lambda: MovingDensity(least_span=-1.0), "density.least_span is -1.0, expected >= 0"),
    ],
)
def test_settings_that_no_run_can_follow_are_refused(make, told):
    with pytest.raises(UsageError, match=told):
        make()


def test_cost_grows_with_steps_and_points(scene):
    one, more = (cost(replace(SHORT, iterations=n), scene).cpu_seconds for n in (100, 1000))
    assert more > 10 * one
    many = replace(SHORT, start=Start(sweep_points=500_000))
    assert cost(SHORT, scene).memory_mb < cost(many, scene).memory_mb
