"""Priors on training views: who gets one, what is kept, what makes them anew."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from helpers.prior_scenes import plane_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.methods.priors import attach, kinds
from splatproof.methods.priors.attach import with_priors
from splatproof.methods.priors.kinds import KINDS, Kind
from splatproof.methods.priors.oracle import prior_of
from splatproof.reference.types.scene import DepthPrior, Scene


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "priors"


@pytest.fixture
def made(monkeypatch) -> list[int]:
    """Indices of the views that the kind "counted" made priors of; it may see no truth."""
    calls: list[int] = []

    def prepare(scene: Scene, weights: Path | None, seed: int):
        def make(index: int) -> DepthPrior:
            calls.append(index)
            assert scene.views[index].load_depth is None
            assert scene.root is None
            return DepthPrior(
                disparity=torch.full((18, 24), seed + 1.0), valid=torch.ones(18, 24) > 0
            )

        return make

    monkeypatch.setitem(KINDS, "counted", Kind(description="", prepare=prepare))
    monkeypatch.setitem(KINDS, "drawn", Kind(description="", prepare=prepare, draws=True))
    monkeypatch.setitem(KINDS, "weighed", Kind(description="", prepare=prepare, weights=True))
    return calls


def test_training_views_have_it_and_keep_it_for_training_and_others_do_not():
    scene = plane_scene()
    given = with_priors(scene, "oracle", 0)
    for index, view in enumerate(given.for_training().views):
        assert (view.load_prior is not None) == (index in scene.train)
        assert view.load_depth is None
        assert view.without_truth().load_prior is None
    for index in scene.train:
        load, truth = given.views[index].load_prior, scene.views[index].load_depth
        assert load is not None
        assert truth is not None
        want = prior_of(truth())
        assert torch.equal(load().disparity, want.disparity)
        assert torch.equal(load().valid, want.valid)


def test_none_is_the_scene_itself(cache):
    scene = plane_scene()
    assert with_priors(scene, "none", 0) is scene
    assert not cache.exists()


def test_kinds_without_truth_see_none_and_only_training_views_are_made(made):
    with_priors(plane_scene(), "counted", 0)
    assert made == [1, 2, 4, 5]


def test_facts_name_kind_hash_and_share():
    facts = with_priors(plane_scene(), "lidar", 0).facts
    assert facts["depth_prior"] == "lidar"
    assert 0.5 < float(facts["depth_prior_valid"]) < 1
    assert (
        facts["depth_prior_sha256"]
        != with_priors(plane_scene(), "oracle", 0).facts["depth_prior_sha256"]
    )
    assert facts == with_priors(plane_scene(), "lidar", 0).facts


def test_views_of_which_nothing_is_said_are_named_each_time(monkeypatch):
    """Also where their priors are kept already."""

    def prepare(scene: Scene, weights: Path | None, seed: int):
        return lambda index: DepthPrior(
            disparity=torch.ones(18, 24), valid=torch.full((18, 24), index > 2)
        )

    monkeypatch.setitem(KINDS, "mute", Kind(description="", prepare=prepare, silent="too dark"))
    scene = plane_scene()
    first, second = (list[str]() for _ in range(2))
    for told in (first, second):
        with_priors(scene, "mute", 0, say=told.append)
    names = ", ".join(scene.views[index].name for index in (1, 2))
    assert first == second == [f"depth prior 'mute' says nothing of {names}: too dark"]


def test_where_something_is_said_of_each_view_nothing_is_told(made):
    told: list[str] = []
    facts = with_priors(plane_scene(), "counted", 0, say=told.append).facts
    assert told == []
    assert "depth_prior_silent" not in facts


def test_they_are_made_once(made):
    with_priors(plane_scene(), "counted", 0, "hash")
    with_priors(plane_scene(), "counted", 5, "hash")  # it does not draw
    assert len(made) == 4


def test_whatever_they_depend_on_makes_them_anew(made, tmp_path):
    scene, weights = plane_scene(), tmp_path / "w"
    weights.write_text("1")
    views = list(scene.views)
    camera = views[1].camera
    views[1] = replace(
        views[1], camera=replace(camera, world_to_camera=camera.world_to_camera + 0.01)
    )
    points = replace(scene.points, positions=scene.points.positions + 1)
    seen = [
        with_priors(scene, "drawn", 0, "hash"),
        with_priors(scene, "drawn", 1, "hash"),
        with_priors(scene, "counted", 0, "hash"),
        with_priors(scene, "counted", 0, "other"),
        with_priors(replace(scene, views=tuple(views)), "counted", 0, "hash"),
        with_priors(replace(scene, train=(1, 2)), "counted", 0, "hash"),
        with_priors(replace(scene, points=points), "counted", 0, "hash"),
        with_priors(replace(scene, facts={"model_sha256": "1"}), "counted", 0, "hash"),
        with_priors(scene, f"weighed:{weights}", 0, "hash"),
    ]
    weights.write_text("2")
    seen.append(with_priors(scene, f"weighed:{weights}", 0, "hash"))
    assert len(made) == 4 * 9 + 2
    assert len({file_of(one) for one in seen}) == 10
    assert seen[-1].facts[kinds.WEIGHTS] != seen[-2].facts[kinds.WEIGHTS]


def file_of(scene: Scene) -> Path:
    load = scene.views[1].load_prior
    assert isinstance(load, partial)
    return load.args[0]


def test_without_files_what_is_looked_at_counts(made):
    scene = plane_scene()
    with_priors(scene, "counted", 0)
    views = list(scene.views)
    views[2] = replace(views[2], load=lambda: torch.zeros(18, 24, 3))
    with_priors(replace(scene, views=tuple(views)), "counted", 0)
    views[2] = replace(scene.views[2], load_sweep=None)
    with_priors(replace(scene, views=tuple(views)), "counted", 0)
    views[2] = replace(scene.views[2], load_mask=lambda: torch.zeros(18, 24) > 0)
    with_priors(replace(scene, views=tuple(views)), "counted", 0)
    views[2] = replace(scene.views[2], load_mask=lambda: torch.ones(18, 24) > 0)
    with_priors(replace(scene, views=tuple(views)), "counted", 0)
    assert len(made) == 20


def test_a_run_that_was_stopped_goes_on_where_it_was(made, cache, monkeypatch):
    write, told = attach.write_tensors, []

    def killed(path, tensors):
        if path.name == "000004.safetensors":
            raise KeyboardInterrupt
        write(path, tensors)

    monkeypatch.setattr(attach, "write_tensors", killed)
    with pytest.raises(KeyboardInterrupt):
        with_priors(plane_scene(), "counted", 0)
    monkeypatch.setattr(attach, "write_tensors", write)
    given = with_priors(
        plane_scene(), "counted", 0, "", lambda done, total: told.append((done, total))
    )
    assert made == [1, 2, 4, 4, 5]
    assert told == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]
    assert given.facts["depth_prior_valid"] == "1.0000"
    assert len(list(cache.rglob("*.safetensors"))) == 4


def test_damaged_files_are_named():
    given = with_priors(plane_scene(), "oracle", 0)
    file, load = file_of(given), given.views[1].load_prior
    assert load is not None
    file.write_bytes(b"x")
    with pytest.raises(DataError, match=f"{file}: not a whole safetensors file.*; remove it"):
        load()
    attach.write_tensors(file, {"depth": torch.ones(2)})
    with pytest.raises(DataError, match="holds depth, expected disparity and valid; remove it"):
        load()


@pytest.mark.parametrize("content", ["{", "[]"])
def test_damaged_facts_of_priors_are_named(content):
    facts = file_of(with_priors(plane_scene(), "oracle", 0)).with_name(attach.SUMMARY)
    facts.write_text(content)
    with pytest.raises(DataError, match=f"{facts}: .*; remove it"):
        with_priors(plane_scene(), "oracle", 0)


def test_a_scene_that_lacks_what_the_kind_needs_is_refused_before_anything_is_kept(cache):
    with pytest.raises(UsageError, match="no training view has a LiDAR sweep"):
        with_priors(plane_scene(sweep=False), "lidar", 0)
    assert not cache.exists()
