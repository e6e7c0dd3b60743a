"""Test views that a scene's own flight never had, from a second scene in the same frame."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.datasets.splits import chosen_views, split_hash
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene, Sweep, View


def with_tests(scene: Scene, tests: Scene, protocol: Protocol) -> Scene:
    """The scene with its own views for training, and those of `tests` as its test views.

    Points and their tracks stay the scene's: no test view observes any.

    Args:
        scene: The scene that is trained on.
        tests: A scene in the same original frame and on the same clock; its shift and its start may
            be others.
        protocol: Its `train_views` and `scored` say which views train and which are scored.
    Raises: DataError where a view's name is in both, or the units differ.
    """
    both = {view.name for view in scene.views} & {view.name for view in tests.views}
    if both:
        raise DataError(f"{tests.root}: test view {min(both)!r} has the name of a training view")
    if tests.units != scene.units:
        raise DataError(f"{tests.root}: units are {tests.units!r}, the scene's {scene.units!r}")
    shift, later = scene.shift - tests.shift, tests.start - scene.start
    moved = tuple(moved_view(view, shift, later) for view in tests.views)
    views = sorted((*scene.views, *moved), key=lambda view: view.name)
    index = {view.name: i for i, view in enumerate(views)}
    names = [view.name for view in views]
    train, test = chosen_views(
        tuple(sorted(index[view.name] for view in scene.views)),
        tuple(sorted(index[view.name] for view in tests.views)),
        protocol,
    )
    new = torch.tensor([index[view.name] for view in scene.views])
    points = replace(scene.points, track_views=new[scene.points.track_views.long()])
    facts = {"split_sha256": split_hash(names, train, test), "tests": tests.name}
    hashes = ("photos_sha256", "cameras_sha256", "model_sha256")
    facts |= {f"tests_{key}": tests.facts[key] for key in hashes if key in tests.facts}
    return replace(
        scene,
        views=tuple(views),
        train=train,
        test=test,
        points=points,
        facts=scene.facts | facts,
        sources=tuple(sorted({*scene.sources, *tests.sources})),
    )


def moved_view(view: View, shift: Float64[Tensor, "3"], later: float = 0.0) -> View:
    """The view in a frame whose origin lies `shift` further on: t' = t + R shift, x' = x - shift.

    Args:
        view: A view of the one frame.
        shift: Where in it the other frame's origin lies.
        later: Its times are told from so many seconds before.
    """
    pose = view.camera.world_to_camera.clone()
    pose[:3, 3] += pose[:3, :3] @ shift
    load = view.load_sweep
    return replace(
        view,
        camera=replace(view.camera, world_to_camera=pose),
        load_sweep=partial(_moved_sweep, load, shift, later) if load else None,
        sweep_time=None if view.sweep_time is None else view.sweep_time + later,
        time=None if view.time is None else view.time + later,
    )


def _moved_sweep(load: Callable[[], Sweep], shift: Float64[Tensor, "3"], later: float) -> Sweep:
    sweep = load()
    return replace(
        sweep,
        positions=(sweep.positions - shift).to(sweep.positions.dtype),
        origin=sweep.origin - shift,
        time=None if sweep.time is None else sweep.time + later,
    )
