"""Things stand on something, nothing drives through anything, and no view looks past the world's end."""

from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from splatproof.datasets.procedural import aerial, courtyard, shapes, street, traffic, tunnel
from splatproof.datasets.procedural import ray_images as frames
from splatproof.datasets.procedural.things import METAL
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.world import Builder

LANDS = ("ground", "water", "rock", "floor")
"""What things stand on, and what stands on nothing."""
FIXED = {"pipe": "to the wall", "tray": "to the wall", "rib": "to the rock"}
"""Kinds that hang on something beside them."""
GAP = 0.35
"""Metres: a slope under a foot of a metre's width, or the mesh of a bumpy floor."""


def floating(caster):
    """Kinds of the objects that have air under all of their lowest points."""
    world, found = caster.world, []
    owner = np.zeros(len(world.vertices), dtype=int)
    owner[world.faces.ravel()] = np.repeat(world.face_objects, 3)
    order = np.argsort(owner, kind="stable")
    ends = np.searchsorted(owner[order], np.arange(len(world.kinds) + 1))
    for identity, kind in enumerate(world.kinds):
        if identity == 0 or kind in LANDS or kind in FIXED:
            continue
        own = world.vertices[order[ends[identity] : ends[identity + 1]]]
        lowest = own[own[:, 2] < own[:, 2].min() + 0.05]
        lowest = np.vstack([lowest, lowest.mean(axis=0)])  # corners may hang over
        down = np.tile([0.0, 0.0, -1.0], (len(lowest), 1))
        above, below = (caster.first(lowest + [0, 0, z], down) for z in (0.02, -1e-3))
        # its own underside in between counts for nothing; below the ground there is nothing
        others = world.face_objects[above.face] != identity
        gap = np.where(others, above.distance - 0.02, below.distance)
        if np.where(np.isinf(gap), 0, gap).min() > GAP:
            found.append(kind)
    return found


@pytest.mark.parametrize(
    "kind",  # the others are built of the same parts
    [k if k == "church" else pytest.param(k, marks=pytest.mark.slow) for k in aerial.SCENES],
)
def test_nothing_floats_over_an_aerial_scene_and_no_view_looks_past_its_end(kind):
    world = aerial.SCENES[kind](0)
    caster = Caster(world)
    assert floating(caster) == []
    for shot in aerial.shots(kind, 0, aerial.PRESETS["large"]):
        depth, _, _ = frames.truth(caster, scaled(shot.camera, 32))
        assert np.isfinite(depth).all(), shot.name


@cache
def drive_of(preset):
    """The large one is the longest; the others are its beginning, but for the views from other lanes."""
    return street.Drive(0, street.PRESETS[preset])


def test_nothing_floats_elsewhere():
    assert floating(drive_of("small").stage(0.0).caster) == []
    assert floating(Caster(tunnel.build(0, tunnel.PRESETS["small"]))) == []
    assert floating(Caster(courtyard.build(0))) == []


def test_what_floats_is_found():
    world = Builder()
    flat = shapes.polygon([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]])
    world.add("ground", [(flat, METAL)])
    for kind, bottom in (("container", 0.0), ("drum", 2.6), ("crate", 5.2), ("sunk", -0.1)):
        x = {"crate": 4.0}.get(kind, 0.0)
        world.add(kind, [(shapes.placed(shapes.box((2, 2, 2.6)), (x, 0.0, bottom)), METAL)])
    assert floating(Caster(world.build())) == ["crate"]


def scaled(camera, width):
    """The same view with fewer pixels."""
    K = camera.K * torch.tensor([[width / camera.width], [width / camera.width], [1.0]])
    return replace(camera, K=K, width=width, height=round(camera.height * width / camera.width))


def still_hits(caster, parts):
    """Kinds of standing things, other than the ground, that the edges of a shape run into."""
    hit = set()
    for shape, _ in parts:
        corners = shape.vertices[shape.faces]
        for a, b in ((0, 1), (1, 2), (2, 0)):
            starts, ways = corners[:, a], corners[:, b] - corners[:, a]
            found = caster.first(starts, ways)
            through = (found.face >= 0) & (found.distance < 1)
            hit |= {caster.world.kinds[caster.world.face_objects[f]] for f in found.face[through]}
    return hit - {"ground"}


def box_around(mover):
    """Least and greatest corner of all that a mover is while it moves, in its own frame."""
    times = (0.0,) if mover.kind == "moving car" else np.arange(0, 1.4, 0.1)
    own = np.concatenate([shape.vertices for t in times for shape, _ in mover.parts(float(t))])
    return own.min(axis=0), own.max(axis=0)


def gap(point, pose, around):
    """Metres from points to a box that stands at a pose; negative inside."""
    local = (point - pose[:3, 3]) @ pose[:3, :3]
    return np.maximum(around[0] - local, local - around[1]).max(axis=-1)


def meets(mover, other, time, boxes):
    """Whether a mover's box reaches into another one's."""
    low, high = boxes[mover]
    shares = np.stack(np.meshgrid(*[np.linspace(0, 1, n) for n in (9, 5, 3)]), -1).reshape(-1, 3)
    pose = mover.pose(time)
    points = (low + (high - low) * shares) @ pose[:3, :3].T + pose[:3, 3]
    return bool((gap(points, other.pose(time), boxes[other]) < 0).any())


@pytest.mark.slow  # half a minute of rays; what each control plants is found below
def test_nothing_in_the_street_goes_through_anything():
    drive = drive_of("large")
    still = Caster(drive.still.build())
    boxes = {mover: box_around(mover) for mover in drive.movers}
    for frame in range(drive.settings.frames):
        time = frame / street.RATE
        for mover in drive.movers:
            if frame % 5 == 0:
                assert still_hits(still, mover.at(time)) == set(), (mover.kind, time)
            for other in drive.movers:
                assert mover is other or not meets(mover, other, time, boxes), time


def test_a_car_that_drives_through_another_is_found():
    first = traffic.car("808080", 4.0, traffic.straight(0.0, 0.0, 5.0))
    second = traffic.car("808080", 4.0, traffic.straight(9.0, 0.5, 2.0))
    boxes = {mover: box_around(mover) for mover in (first, second)}
    assert not meets(first, second, 0.0, boxes)
    assert meets(first, second, 2.5, boxes)
    wall = Builder()
    wall.add("building", [(shapes.placed(shapes.box((1, 9, 4)), (12.0, 0.0, 0.0)), METAL)])
    assert still_hits(Caster(wall.build()), first.at(2.0)) == {"building"}


@pytest.mark.parametrize(
    ("length", "presets"),
    [("small", ["small"]), pytest.param("large", [*street.PRESETS], marks=pytest.mark.slow)],
)
def test_no_street_view_is_taken_from_inside_something(length, presets):
    drive = drive_of(length)
    still = Caster(drive.still.build())
    boxes = {mover: box_around(mover) for mover in drive.movers}
    around = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    ways = around[np.abs(around).sum(axis=1) > 0].astype(float)
    moments = {
        (shot.time, tuple(shot.camera.centre.tolist()))
        for preset in presets
        for shot in street.shots(replace_settings(drive, street.PRESETS[preset]))
    }
    assert len(moments) > 10
    for time, place in moments:
        eye = np.array(place)
        assert still.first(np.tile(eye, (26, 1)), ways).distance.min() > 0.5
        for mover in drive.movers:
            assert gap(eye, mover.pose(time), boxes[mover]) > 0.3, (time, place, mover.kind)


def replace_settings(drive, settings):
    """The same street, seen as other settings say."""
    other = copy(drive)
    other.settings = settings
    return other
