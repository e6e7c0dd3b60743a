"""Motion in the plan: when Gaussians move, what of a plan they follow, and that such a run is like any other."""

from dataclasses import fields, replace

import pytest
import torch

from helpers.tiny_drive import tiny_drive
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.methods.auto.facts import SceneFacts, facts_of, moving_share
from splatproof.methods.auto.fit import fit
from splatproof.methods.auto.motion import planned_motion
from splatproof.methods.auto.moving import moving, without_what_is_lacking
from splatproof.methods.auto.planner import usual
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.contracts.reconstruction import Origin, Reconstruction, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.training.density import Density
from splatproof.reference.types.scene import Scene

DRIVE = tiny_drive()
ASKED = AutoSettings(seconds=20.0, steps=30, probe_share=0.0, motion=True)


def facts(**more) -> SceneFacts:
    found = SceneFacts(
        views=40, width=400, height=300, points=10_000, track=5.0, coverage=8.0, neighbours=10.0,
        angle=30.0, bare=0.3, detail=5.0, noise=1.0, exposure=0.1, moments=12, swept=True,
        moving=0.02, image_bytes=1,
    )  # fmt: skip
    return replace(found, **more)


@pytest.mark.parametrize(
    ("known", "moves", "because"),
    [
        ({}, True, "2.00 % of the LiDAR's returns lie on things in motion"),
        ({"moving": 0.0}, False, "0.00 % of the LiDAR's returns"),
        ({"moving": 0.0, "swept": False}, False, "no LiDAR sweep tells what moves"),
    ],
)
def test_gaussians_move_where_sweeps_show_motion(known, moves, because):
    found, (choice,) = planned_motion(DRIVE, AutoSettings(), facts(**known))
    assert found == moves
    assert because in choice.because


def test_nothing_is_said_of_a_scene_of_one_moment():
    assert planned_motion(tiny_scene(), AutoSettings(), facts(moments=1)) == (False, ())
    assert planned_motion(tiny_scene(), AutoSettings(), facts(moments=0)) == (False, ())


def test_what_is_fixed_is_kept():
    assert planned_motion(DRIVE, AutoSettings(motion=False), facts())[0] is False
    assert planned_motion(DRIVE, ASKED, facts(moving=0.0))[0] is True
    found, (choice,) = planned_motion(DRIVE, AutoSettings(dropout=0.1), facts())
    assert not found
    assert choice.because.startswith("dropout is given")
    with pytest.raises(UsageError, match="dropout is 0.1, expected None where motion is True"):
        AutoSettings(motion=True, dropout=0.1)


def test_motion_is_refused_where_nothing_says_what_moves():
    with pytest.raises(DataError, match="has no time"):
        planned_motion(tiny_scene(), ASKED, facts())
    blind = replace(DRIVE, views=tuple(replace(view, load_sweep=None) for view in DRIVE.views))
    with pytest.raises(DataError, match="LiDAR sweep; set motion = False"):
        planned_motion(blind, ASKED, facts())


def test_facts_know_sweeps_and_scenes_without_them():
    assert facts_of(DRIVE, 2**20).swept
    assert facts_of(DRIVE, 2**20).moving == moving_share(DRIVE)
    still = facts_of(tiny_scene(), 2**20)
    assert (still.swept, still.moving) == (False, 0.0)


def test_what_moves_follows_the_plan():
    settings = replace(
        without_what_is_lacking(usual(AutoSettings(sh_degree=1), facts())), iterations=123,
        exposure="gain",
    )  # fmt: skip
    settings = replace(settings, density=replace(settings.density, most=777))
    found = moving(settings, DRIVE)
    assert (found.iterations, found.sh_degree, found.exposure) == (123, 1, "gain")
    for part in fields(Density):
        assert getattr(found.density, part.name) == getattr(settings.density, part.name)
    assert found.sky.weight > 0
    clear = replace(DRIVE, views=tuple(replace(view, load_sky=None) for view in DRIVE.views))
    assert moving(settings, clear).sky.resolution == 0


def renders(model: Reconstruction, scene: Scene) -> list[torch.Tensor]:
    return [model.render(view.without_truth()).colour for view in scene.views]


def test_the_same_plan_gives_the_same_moving_model_which_is_saved_and_loaded(tmp_path):
    told: dict[str, str] = {}
    one = fit(DRIVE, ASKED, Run(threads=1, on_fact=told.__setitem__))
    again = fit(DRIVE, ASKED, Run(threads=1))
    assert one.kind == "pvg"
    assert told["plan: motion"] == "Gaussians that move (as method pvg's) (given)"
    save_model(one, tmp_path / "model", Origin(method="auto"))
    loaded = load_reconstruction(tmp_path / "model")
    for other in (again, loaded):
        for a, b in zip(renders(one, DRIVE), renders(other, DRIVE), strict=True):
            assert torch.equal(a, b)
    still = fit(DRIVE, replace(ASKED, motion=False), Run(threads=1))
    assert still.kind == "explicit"


class Killed(Exception):
    """Stands for a kill between two steps."""


def test_a_killed_run_goes_on_to_the_same_moving_model(tmp_path):
    def killing(step, total, values):
        if step == 20:
            raise Killed

    run = Run(threads=1, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(DRIVE, ASKED, replace(run, report=killing))
    found = renders(fit(DRIVE, ASKED, run), DRIVE)
    for a, b in zip(renders(fit(DRIVE, ASKED, Run(threads=1)), DRIVE), found, strict=True):
        assert torch.equal(a, b)


def test_a_moving_model_ends_where_photos_kept_back_are_good_enough():
    told: dict[str, str] = {}
    run = Run(threads=1, on_fact=told.__setitem__)
    fit(DRIVE, replace(ASKED, steps=60, db=1.0), run)
    assert told["quality asked for"].startswith("reached: ")
