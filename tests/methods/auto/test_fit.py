"""Method auto from end to end on a scene of a few pixels."""

import json
from dataclasses import replace

import pytest
import torch

from helpers.aerial_scene import without_points
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError
from splatproof.methods.auto import fit as auto
from splatproof.methods.auto import probe
from splatproof.methods.auto.facts import facts_of
from splatproof.methods.auto.fit import PLAN, fit, planned
from splatproof.methods.auto.goal import keep_back
from splatproof.methods.auto.probe import probe_of
from splatproof.methods.auto.recount import Recount
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.image_room import READING_BYTES
from splatproof.methods.training.resolution import Resolution
from splatproof.methods.training.schedules import shrink

ASKED = AutoSettings(seconds=20.0, steps=30, probe_share=0.0)


class Killed(Exception):
    """Stands for a kill between two steps."""


def same(one, other) -> bool:
    return all(torch.equal(getattr(one.bake(), n), getattr(other.bake(), n)) for n in FIELDS)


def test_the_same_plan_gives_the_same_model_and_the_record_says_it():
    facts: dict[str, str] = {}
    one = fit(tiny_scene(), ASKED, Run(threads=1, on_fact=facts.__setitem__))
    again = fit(tiny_scene(), ASKED, Run(threads=1))
    assert same(one, again)
    assert facts["plan: steps"] == "30 (given)"
    assert json.loads(facts["planned settings"])["iterations"] == 30


def test_a_killed_run_goes_on_by_its_plan(tmp_path, monkeypatch):
    """On a machine that is slower now, too: the plan is not made twice."""
    straight = fit(tiny_scene(), ASKED, Run(threads=1))

    def killing(step, total, values):
        if step == 20:
            raise Killed

    run = Run(threads=1, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(tiny_scene(), ASKED, replace(run, report=killing))
    assert (tmp_path / "checkpoint" / PLAN).exists()
    monkeypatch.setattr(auto, "planned", lambda *_: pytest.fail("planned again"))
    assert same(straight, fit(tiny_scene(), ASKED, run))


def test_a_plan_of_other_wishes_is_made_anew(tmp_path):
    run = Run(threads=1, folder=tmp_path)
    fit(tiny_scene(), ASKED, run)
    (tmp_path / "checkpoint" / "training.safetensors").unlink()
    fit(tiny_scene(), replace(ASKED, steps=20), run)
    told = json.loads((tmp_path / "checkpoint" / PLAN).read_text())
    assert told["settings"]["iterations"] == 20


def test_a_scene_without_points_starts_from_drawn_ones():
    scene = tiny_scene()
    facts: dict[str, str] = {}
    fit(without_points(scene), ASKED, Run(threads=1, on_fact=facts.__setitem__))
    assert facts["plan: start"].startswith("10,000 points drawn")
    assert facts["plan: points"].startswith("108 of 10,000")  # a photo has 432 pixels
    fit(scene, ASKED, Run(threads=1, on_fact=(facts := {}).__setitem__))
    assert "plan: start" not in facts


def test_steps_follow_the_speed_of_the_machine():
    found = planned(tiny_scene(), AutoSettings(seconds=3.0, probe_share=0.0), Run(threads=1))
    assert found.plan.settings.iterations >= 100
    assert found.plan.seconds < 3 or found.plan.settings.iterations == 100


def test_the_probe_holds_views_out_and_keeps_its_hands_off_the_others():
    scene = tiny_scene(views=10)
    found = probe_of(scene, Run(threads=1))
    assert found is not None
    held, seen = {view.name for view in found.held}, {v.name for v in found.scene.train_views}
    assert held
    assert not held & seen
    assert held | seen == {view.name for view in scene.train_views}
    scores = found.score(Settings(iterations=20, sh_degree=0))
    assert len(scores) == len(found.held)
    assert scores == found.score(Settings(iterations=20, sh_degree=0))
    assert scores != found.score(Settings(iterations=20, sh_degree=0), 1)
    assert probe_of(tiny_scene(views=4), Run()) is None


def test_nothing_of_a_held_out_photo_is_fitted(monkeypatch):
    """It is shown in the mean exposure, however bright it is: else exposures would always win."""
    shown = []
    monkeypatch.setattr(probe, "psnr", lambda image, *_: shown.append(image) or 0.0)
    found = probe_of(tiny_scene(views=10), Run(threads=1))
    assert found is not None

    def darker(view):
        return replace(view, load=lambda: 0.5 * view.load())

    held = tuple(darker(view) for view in found.held)
    dark = replace(found, held=held, photos=tuple(view.load() for view in held))
    for one in (found, dark):
        one.score(Settings(iterations=20, sh_degree=0, exposure="gain"))
    half = len(found.held)
    assert len(shown) == 2 * half
    assert all(torch.equal(a, b) for a, b in zip(shown[:half], shown[half:], strict=True))


def test_a_probe_decides_within_its_share(monkeypatch):
    asked = AutoSettings(seconds=100.0, steps=10, probe_share=0.5)
    monkeypatch.setattr(auto, "facts_of", lambda *_: replace(facts_of(*_), exposure=0.1))
    monkeypatch.setattr(auto, "PROBE_STEPS", 60)
    found = planned(tiny_scene(views=10), asked, Run(threads=1))
    names = [choice.component for choice in found.plan.choices]
    assert names == [
        "matched points", "completed depths", "exposure", "blocks", "points", "resolution", "density", "splitting", "Gaussians",
        "largest scale", "thickness", "harmonics", "opacity term", "views a step", "steps", "rates", "dropout", "anchors",
    ]  # fmt: skip
    assert found.plan.choices[2].because.startswith("probe: ")


@pytest.mark.parametrize(("asked", "share"), [(None, 0.2), (0.0, 0.0), (0.4, 0.4)])
def test_a_probe_has_the_bound_of_few_looks_whatever_the_plan_has(asked, share, monkeypatch):
    """One photo is looked at 100 times in the plan, where that bound is not usual."""
    seen: list[Settings] = []

    def competing(usual, *_):
        seen.append(usual)
        return usual, ()

    monkeypatch.setattr(auto, "facts_of", lambda *_: replace(facts_of(*_), exposure=0.1))
    monkeypatch.setattr(auto, "compete", competing)
    wishes = AutoSettings(seconds=20.0, steps=500, probe_share=0.5, widest_at_points=asked)
    found = planned(tiny_scene(), wishes, Run(threads=1))
    assert [one.widest_at_points for one in seen] == [share]
    assert found.plan.settings.widest_at_points == (asked or 0.0)


def test_a_model_is_no_larger_than_was_asked_for_however_many_points_it_starts_from(tmp_path):
    asked = AutoSettings(megabytes=0.02, seconds=20.0, steps=40, probe_share=0.0, exposure="gain")
    save_model(fit(tiny_scene(points=400), asked, Run(threads=1)), tmp_path / "model", Origin())
    size = sum(path.stat().st_size for path in (tmp_path / "model").rglob("*") if path.is_file())
    assert 0.01 * 2**20 < size <= 0.02 * 2**20


def test_pixels_that_do_not_count_judge_nothing():
    mask = torch.ones(18, 24, dtype=torch.bool)
    mask[:, 12:] = False
    scene = tiny_scene(views=10, mask=mask)

    def spoilt(view):
        return replace(view, load=lambda: torch.where(mask[..., None], view.load(), 0.0))

    other = replace(scene, views=tuple(map(spoilt, scene.views)))
    scores = []
    for one in (scene, other):
        found = probe_of(one, Run(threads=1))
        assert found is not None
        scores.append(found.score(Settings(iterations=20, sh_degree=0)))
    assert scores[0] == scores[1]


def goal_of(db: float) -> tuple[dict[str, str], dict[str, int]]:
    facts: dict[str, str] = {}
    counts: dict[str, int] = {}
    run = Run(threads=1, on_fact=facts.__setitem__, on_count=counts.__setitem__)
    fit(tiny_scene(views=10), replace(ASKED, steps=60, db=db), run)
    return facts, counts


def test_training_ends_where_photos_kept_back_are_good_enough():
    facts, counts = goal_of(1.0)
    assert counts["steps"] == 10
    assert facts["quality asked for"].startswith("reached: ")
    assert "on 1 photos kept back after 10 steps, 1 asked for" in facts["quality asked for"]
    facts, counts = goal_of(99.0)
    assert counts["steps"] == 60
    assert facts["quality asked for"].startswith("not reached: ")


def test_a_killed_run_ends_at_its_goal(tmp_path):
    def killing(step, total, values):
        if step == 20:
            raise Killed

    scene, asked = tiny_scene(views=10), replace(ASKED, steps=1000, db=1.0)
    straight = fit(scene, asked, Run(threads=1))  # the first look is after 25 steps
    run = Run(threads=1, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(scene, asked, replace(run, report=killing))
    assert same(straight, fit(scene, asked, run))


def test_photos_kept_back_are_never_trained_on():
    scene = tiny_scene(views=10)
    kept = keep_back(scene)
    held, seen = {view.name for view in kept.views}, {view.name for view in kept.scene.train_views}
    assert held
    assert not held & seen
    assert held | seen == {view.name for view in scene.train_views}
    with pytest.raises(DataError, match="3 training photos, expected at least 4"):
        keep_back(replace(scene, train=scene.train[:3]))


def test_photos_are_read_once_and_only_as_long_as_there_is_time():
    reads = []
    scene = tiny_scene()

    def counted(view):
        return replace(view, load=lambda: reads.append(view.name) or view.load())

    scene = replace(scene, views=tuple(counted(view) for view in scene.views))
    auto.read_ahead(auto.remembering(scene, 0), -1.0, 2)
    assert reads == []
    remembered = auto.remembering(scene, 2**20)
    for _ in range(2):
        auto.read_ahead(remembered, 10.0, 2)
    assert sorted(reads) == [view.name for view in scene.train_views]


def test_gaussians_are_bounded_by_what_photos_leave_of_the_memory(monkeypatch):
    seen = []
    for name in ("bounded", "plan"):
        real = getattr(auto, name)
        monkeypatch.setattr(
            auto, name, lambda *given, real=real: seen.append(given[-1]) or real(*given)
        )
    planned(tiny_scene(), ASKED, Run(threads=1, image_bytes=12_345_678))
    assert seen == [12_345_678, 12_345_678]


@pytest.mark.parametrize("asked", [{"steps": 5}, {"steps": None, "coarsest": 1.0}])
def test_photos_that_keep_their_size_are_read_side_by_side_as_far_as_memory_goes(
    monkeypatch, asked
):
    readers = []
    monkeypatch.setattr(auto, "read_ahead", lambda scene, seconds, count: readers.append(count))
    monkeypatch.setattr(torch, "get_num_threads", lambda: 4)
    scene = tiny_scene()
    one = READING_BYTES * 24 * 18
    for room in (one, 3 * one, 99 * one):
        planned(scene, replace(ASKED, **asked), Run(image_bytes=room))
    assert readers == [1, 3, 4]


def test_steps_are_counted_again_where_photos_stay_small_to_the_end():
    settings = Settings(iterations=1000, resolution=Resolution(coarsest=2.0, full_from=1.0))
    told: list[int] = []
    recount = Recount(settings, 50.0, 5000, told.append)
    assert recount.first == round(settings.density.stop * shrink(1000)) + 1
    late = replace(settings, resolution=Resolution(coarsest=2.0, full_from=0.8))
    assert Recount(late, 50.0, 5000, told.append).first == 801
