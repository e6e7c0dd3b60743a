"""Motion in the plan: when Gaussians move, what of a plan they follow, and that such a run is like any other."""

import time
from dataclasses import fields, replace

import pytest

from helpers.tiny_drive import tiny_drive
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.procedural import street
from splatproof.datasets.procedural.exporting import make_scene
from splatproof.methods.auto import facts as facts_module
from splatproof.methods.auto import fit as fitting
from splatproof.methods.auto.base import moving, prepare, without_what_is_lacking
from splatproof.methods.auto.facts import PAIRS, SceneFacts, facts_of, moving_share
from splatproof.methods.auto.fit import RESERVE, fit
from splatproof.methods.auto.motion import LEAST_MOVING, planned_motion
from splatproof.methods.auto.recount import Recount
from splatproof.methods.auto.settings import LACKING, AutoSettings
from splatproof.methods.auto.usual import usual
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.sweep_points import TimedPoints
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import Scene

DRIVE = tiny_drive()
ASKED = AutoSettings(seconds=20.0, steps=30, probe_share=0.0, motion=True)


def facts(**more) -> SceneFacts:
    found = SceneFacts(
        views=40, width=400, height=300, points=10_000, track=5.0, coverage=8.0, neighbours=10.0,
        angle=30.0, down=0.9, bare=0.3, detail=5.0, noise=1.0, exposure=0.1, moments=12, swept=True,
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


def test_nothing_moves_in_a_file_of_a_bound_that_what_moves_does_not_have():
    found, (choice,) = planned_motion(DRIVE, AutoSettings(megabytes=1.0), facts())
    assert not found
    assert choice.because == "megabytes is given, and Gaussians that move have no such bound"
    with pytest.raises(UsageError, match="motion is True, .* megabytes bounds the saved model"):
        AutoSettings(megabytes=1.0, motion=True)


def test_nothing_is_said_of_a_scene_of_one_moment():
    assert planned_motion(tiny_scene(), AutoSettings(), facts(moments=1)) == (False, ())
    assert planned_motion(tiny_scene(), AutoSettings(), facts(moments=0)) == (False, ())


def test_what_is_fixed_is_kept():
    assert planned_motion(DRIVE, AutoSettings(motion=False), facts())[0] is False
    assert planned_motion(DRIVE, ASKED, facts(moving=0.0))[0] is True
    found, (choice,) = planned_motion(DRIVE, AutoSettings(dropout=0.1), facts())
    assert not found
    assert choice.because.startswith("dropout is given")
    with pytest.raises(
        UsageError, match="dropout is 0.1, expected 0, or None, where motion is True"
    ):
        AutoSettings(motion=True, dropout=0.1)


WITHOUT = AutoSettings(
    coarsest=1.0, opacity_weight=0.0, dropout=0.0, rates=1.0, split_gradient=0.0, completed=False
)  # fmt: skip


@pytest.mark.parametrize("name", sorted(LACKING))
def test_to_go_without_what_motion_lacks_leaves_motion(name):
    asked = replace(AutoSettings(), **{name: getattr(WITHOUT, name)})
    assert getattr(asked, name) is not None
    assert planned_motion(DRIVE, asked, facts())[0]
    assert replace(WITHOUT, motion=True).against_motion() == {}


def test_motion_is_refused_where_nothing_says_what_moves():
    with pytest.raises(DataError, match="has no time"):
        planned_motion(tiny_scene(), ASKED, facts())
    blind = replace(DRIVE, views=tuple(replace(view, load_sweep=None) for view in DRIVE.views))
    with pytest.raises(DataError, match="LiDAR sweep; set motion = False"):
        planned_motion(blind, ASKED, facts())


def test_facts_know_sweeps_and_scenes_without_them():
    assert facts_of(DRIVE).swept
    assert facts_of(DRIVE).moving == moving_share(DRIVE)
    still = facts_of(tiny_scene())
    assert (still.swept, still.moving) == (False, 0.0)


def test_of_a_long_drive_pairs_of_moments_are_looked_at(monkeypatch):
    long, looked = tiny_drive(moments=40), []
    told = facts_module.timed_points

    def noted(scene: Scene, moments: list[float]) -> TimedPoints:
        looked.append(moments)
        return told(scene, moments)

    monkeypatch.setattr(facts_module, "timed_points", noted)
    moving_share(DRIVE)
    assert looked == [[view.time for view in DRIVE.train_views]]
    looked.clear()
    moving_share(long)
    times = [view.time for view in long.train_views]
    assert looked == [
        times[first : first + 2] for first in map(times.index, [a for a, _ in looked])
    ]
    assert len(looked) == PAIRS
    assert (looked[0][0], looked[-1][1]) == (times[0], times[-1])


def test_what_is_prepared_is_counted_in_the_seconds(monkeypatch):
    spent, left = {}, []

    class Noted(Recount):
        def __init__(self, settings: Settings, seconds: float, *more) -> None:
            super().__init__(settings, seconds, *more)
            left.append(seconds)

    def slowly(*given, **more):
        time.sleep(0.5)
        return prepare(*given, **more)

    monkeypatch.setattr(fitting, "Recount", Noted)
    monkeypatch.setattr(fitting, "prepare", slowly)
    asked = AutoSettings(seconds=2.0, probe_share=0.0, motion=True)
    fit(DRIVE, asked, Run(threads=1, on_stage=spent.__setitem__))
    assert left[0] <= 2.0 * (1 - RESERVE) - spent["plan"] - 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("cars", "moves"), [(0, False), (1, True)])
def test_a_drive_in_which_nothing_moves_is_told_from_one_with_a_car(
    tmp_path, monkeypatch, cars, moves
):
    every = street.movers
    monkeypatch.setattr(street, "movers", lambda seed: every(seed)[:cars])
    small = replace(street.PRESETS["small"], width=120, height=80, samples=1)
    folder = make_scene(street.plan(1, small), tmp_path / "drive", lambda done, total: None)
    share = moving_share(open_scene(str(folder), load_protocol("default")).for_training())
    assert (share >= LEAST_MOVING) == moves
    assert share < LEAST_MOVING / 2 or share > 2 * LEAST_MOVING


def test_what_moves_follows_the_plan():
    settings = replace(
        without_what_is_lacking(usual(AutoSettings(sh_degree=1), facts())), iterations=123,
        exposure="gain",
    )  # fmt: skip
    settings = replace(settings, density=replace(settings.density, most=777, pace="even"))
    found = moving(settings, DRIVE)
    assert (found.iterations, found.sh_degree, found.exposure) == (123, 1, "gain")
    for part in fields(Density):
        assert getattr(found.density, part.name) == getattr(settings.density, part.name)
    assert found.sky.weight > 0
    clear = replace(DRIVE, views=tuple(replace(view, load_sky=None) for view in DRIVE.views))
    assert moving(settings, clear).sky.resolution == 0
