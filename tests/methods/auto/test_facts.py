"""What is measured of a scene: planted values come out, and moving the scene changes nothing."""

import weakref
from dataclasses import asdict, replace

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError
from splatproof.methods.auto.facts import facts_of, noise
from splatproof.methods.auto.words import told
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, SparsePoints


def tracked(scene: Scene) -> Scene:
    """The scene whose points know which training views have them in their image."""
    rows = []
    for index in scene.train:
        camera = scene.views[index].camera
        pixels, depth = project_points(camera, scene.points.positions)
        size = torch.tensor([camera.width, camera.height])
        rows.append((depth > 0) & ((pixels >= 0) & (pixels < size)).all(dim=1))
    seen = torch.stack(rows, dim=1)
    views = torch.tensor(scene.train).expand(len(seen), -1)[seen]
    starts = torch.cat([torch.zeros(1, dtype=torch.int64), seen.sum(dim=1).cumsum(0)])
    points = replace(scene.points, track_starts=starts, track_views=views)
    return replace(scene, points=points)


def shaded(scene: Scene, gains: dict[int, float]) -> Scene:
    """The scene with some photos darker by a factor."""

    def load(view, gain):
        return lambda: view.load() * gain

    views = [
        replace(view, load=load(view, gains.get(index, 1.0)))
        for index, view in enumerate(scene.views)
    ]
    return replace(scene, views=tuple(views))


def test_what_is_counted():
    scene = tracked(tiny_scene())
    facts = facts_of(scene)
    assert (facts.views, facts.width, facts.height, facts.points) == (5, 24, 18, 40)
    assert facts.image_bytes == 5 * 24 * 18 * 12
    assert facts.track == pytest.approx(facts.coverage), "each point is tracked where it falls"
    assert facts.neighbours == 4
    assert 0 < facts.angle < 45
    assert 0 <= facts.bare < 1
    assert facts.moments == 0


def test_a_scene_without_tracks_says_so():
    facts = facts_of(tiny_scene())
    words = {what: (value, meaning) for what, value, meaning in told(facts, facts.points)}
    assert words["baselines"][0] == "not known"
    assert facts.coverage > 0


def test_planted_exposure_comes_out():
    """Two of five photos at 0.7: ln 0.7 times the standard deviation of a 2 in 5 draw."""
    scene = tracked(tiny_scene())
    assert facts_of(scene).exposure < 0.1
    planted = facts_of(shaded(scene, {2: 0.5, 3: 0.5})).exposure
    assert planted == pytest.approx(0.693 * (0.4 * 0.6) ** 0.5, abs=0.1)


def test_what_a_mask_hides_is_no_change_of_light():
    scene = tracked(tiny_scene(points=120))
    alike = facts_of(scene).exposure
    mask = torch.zeros(18, 24, dtype=torch.bool)
    mask[:, :9] = True
    views = [
        replace(view, load=lambda view=view: view.load() * mask[..., None], load_mask=mask.clone)
        if index in scene.train[:2]
        else view
        for index, view in enumerate(scene.views)
    ]
    assert facts_of(replace(scene, views=tuple(views))).exposure == pytest.approx(alike, abs=0.1)


def test_a_change_of_light_in_the_last_third_of_a_flight_is_seen():
    """13 of 40 photos at half: ln 0.5 times the standard deviation of an 8 in 24 draw, to a photo more or fewer."""
    few = tiny_scene()
    views = tuple(few.train_views[index % 5] for index in range(41))
    scene = tracked(replace(few, views=views, train=tuple(range(1, 41))))
    facts = facts_of(shaded(scene, dict.fromkeys(range(28, 41), 0.5)))
    assert facts.exposure == pytest.approx(0.693 * (1 / 3 * 2 / 3) ** 0.5, rel=0.1)


def test_photos_are_held_one_at_a_time():
    """The first photo is gone when the second is read: 24 of twelve million pixels take 3 GiB."""
    scene, alive, most = tracked(tiny_scene(views=12)), [0], []

    def watched(view):
        def load():
            photo = view.load()
            alive[0] += 1
            most.append(alive[0])
            weakref.finalize(photo, lambda: alive.__setitem__(0, alive[0] - 1))
            return photo

        return replace(view, load=load)

    facts_of(replace(scene, views=tuple(watched(view) for view in scene.views)))
    assert most == [1] * 11


@pytest.mark.parametrize("sigma", [0.01, 0.03])
def test_planted_noise_comes_out(sigma):
    """A ramp with noise: the filter does not see the ramp; grey is the mean of three draws."""
    generator = torch.Generator().manual_seed(0)
    ramp = torch.linspace(0.2, 0.8, 64)[:, None, None].repeat(1, 64, 3)
    draw = torch.randn(64, 64, 1, generator=generator) * sigma
    assert noise(ramp) < 0.1
    assert noise(ramp + draw) == pytest.approx(255 * sigma, rel=0.1)


def test_a_moved_scene_has_the_same_facts():
    scene = tracked(tiny_scene())
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)).double())[
        0
    ]
    turn = turn * turn.det()
    shift = torch.tensor([3.0, -2.0, 5.0], dtype=torch.float64)

    def moved(camera):
        pose = camera.world_to_camera.clone()
        pose[:3, :3] = pose[:3, :3] @ turn.T
        pose[:3, 3] = pose[:3, 3] - pose[:3, :3] @ shift
        return replace(camera, world_to_camera=pose)

    views = tuple(replace(view, camera=moved(view.camera)) for view in scene.views)
    points = replace(scene.points, positions=scene.points.positions @ turn.T + shift)
    before, after = (
        facts_of(scene),
        facts_of(replace(scene, views=views, points=points, up=turn @ scene.up)),
    )
    for name, value in asdict(before).items():
        assert getattr(after, name) == pytest.approx(value, abs=1e-6, nan_ok=True), name


def test_held_out_photos_are_not_looked_at():
    def hidden():
        raise AssertionError("a held-out photo was read")

    scene = tracked(tiny_scene())
    views = list(scene.views)
    views[0] = replace(views[0], load=hidden)
    facts_of(replace(scene, views=tuple(views)))


def test_a_scene_without_points_is_refused():
    scene = tiny_scene()
    none = SparsePoints(
        positions=scene.points.positions[:0], colours=scene.points.colours[:0],
        track_starts=torch.zeros(1, dtype=torch.int64), track_views=scene.points.track_views,
    )  # fmt: skip
    with pytest.raises(DataError, match="0 sparse points"):
        facts_of(replace(scene, points=none))
