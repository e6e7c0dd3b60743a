"""What a method gets of a scene: no held-out image, no true depth, no mask of what moves, no way to them.

A search goes through all that the scene for training holds, calls what can be called, and listens to
which files are opened. The same search must find everything in the scene that hides nothing, and in
scenes that hide it badly.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers import tiny_worlds
from helpers.adapter_checks import fixtures
from helpers.reachable import called, opened_files, reachable
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import SplatproofError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.procedural import street
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene, Sweep, View

RULES = Protocol(name="test", source="ours", hold=2, hold_unit="time")
TRUTH = ("depth", "moving", "dynamic_masks", "label_02")
"""Folders of what is for scoring only."""


def _street(made: Path) -> Scene:
    """Depth, masks of sky and movers, LiDAR; held-out moments, and test views from other lanes."""
    scene = open_scene(made, RULES)
    lanes = open_scene(made, replace(RULES, test_folder=street.SHIFTED))
    added = [view for view in lanes.views if view.name not in {v.name for v in scene.views}]
    views = tuple(sorted((*scene.views, *added), key=lambda view: view.name))
    held = {view.name for view in (*scene.test_views, *added)}
    train = tuple(i for i, view in enumerate(views) if view.name not in held)
    test = tuple(i for i, view in enumerate(views) if view.name in held)
    return replace(scene, views=views, train=train, test=test, sources=lanes.sources)


def _waymo(folder: Path) -> Scene:
    """Bent photos, which share their undistortion, LiDAR, sky, and masks of what moves."""
    fixtures("waymo").drivestudio(folder)
    return open_scene(folder, RULES)


def _kitti(folder: Path) -> Scene:
    """Masks of what moves are made of boxes, LiDAR, sky of one camera."""
    boxes = fixtures("kitti_boxes")
    lines = [boxes.label(i, 0, "Car", *boxes.place(i)) for i in range(boxes.FRAMES)]
    return open_scene(boxes.tracking(folder, lines), RULES)


@pytest.fixture(scope="module", params=[_street, _waymo, _kitti])
def scene(request, tmp_path_factory) -> Scene:
    if request.param is _street:
        plan = tiny_worlds.plan("street")
        return _street(tiny_worlds.made_once("street", plan, request.config, tmp_path_factory))
    return request.param(tmp_path_factory.mktemp("scene"))


def secrets(scene: Scene) -> tuple[set[Path], list[Tensor]]:
    """Files and tensors that training must not reach, found by file names and by the whole scene.

    A whole moment is held out, so a file is secret if its frame's number is that of a held-out view.
    """
    held = {_frame(view.name) for view in scene.test_views}
    assert not held & {_frame(view.name) for view in scene.train_views}
    files = {
        path.resolve()
        for path in scene.sources
        if _frame(path.name) in held or {*TRUTH, street.SHIFTED} & set(path.parts)
    }
    tensors = [view.load() for view in scene.test_views]
    for view in scene.views:
        tensors += [view.load_depth()] if view.load_depth else []
        tensors += list(view.load_moving().values()) if view.load_moving else []
    return files, [tensor for tensor in tensors if tensor.float().std() > 0]  # not an empty mask


def _frame(name: str) -> str:
    found = re.search(r"\d+", Path(name).name)
    assert found
    return str(int(found.group()))


def leaks(scene: Scene, files: set[Path], tensors: list[Tensor]) -> dict[str, set[str]]:
    """What of `files` and `tensors` is found through a scene: by a path, in memory, by opening."""
    found: dict[str, set[str]] = {"path": set(), "memory": set(), "opened": set()}
    folders = {parent for path in files for parent in path.parents}
    texts = {str(path) for path in files | {f for f in folders if len(f.parts) > 3}}
    with opened_files() as opened:
        results = list(called(scene))
    found["opened"] = {name for name in opened if Path(name).resolve() in files}
    for thing in (each for start in (scene, results) for each in reachable(start)):
        if isinstance(thing, Path) and thing.resolve() in files | folders:
            found["path"].add(str(thing))
        elif isinstance(thing, str) and any(thing.rstrip("/").endswith(text) for text in texts):
            found["path"].add(thing)
        elif isinstance(thing, Tensor | np.ndarray) and _is_any(torch.as_tensor(thing), tensors):
            found["memory"].add(f"{tuple(thing.shape)} {thing.dtype}")
    return {kind: names for kind, names in found.items() if names}


def _is_any(tensor: Tensor, secret: list[Tensor]) -> bool:
    return any(tensor.dtype == s.dtype and torch.equal(tensor, s) for s in secret)


def test_nothing_hidden_is_reached_through_a_scene_for_training(scene):
    files, tensors = secrets(scene)
    assert leaks(scene.for_training(), files, tensors) == {}


def test_control_the_search_finds_all_in_the_scene_that_hides_nothing(scene):
    files, tensors = secrets(scene)
    # a scene knows its sources as paths; what it is asked for besides comes from the views
    found = leaks(replace(scene, root=None, sources=()), files, tensors)
    assert set(found) == {"path", "memory", "opened"}
    assert {Path(name).resolve() for name in found["path"] | found["opened"]} >= files
    assert leaks(replace(scene, views=()), files, tensors).keys() == {"path"}


def _all_photos(scene: Scene) -> object:
    photos = [path for path in scene.sources if path.suffix in (".png", ".jpg")]
    return lambda index: photos[index]


BAD: dict[str, Callable[[Scene], object]] = {
    "a list of photos in a closure": _all_photos,
    "the scene's folder in a partial": lambda scene: partial(Path, scene.root or ""),
    "a folder of photos in a default": lambda scene: _with_default(scene.sources[0].parent),
    "a path in words": lambda scene: {"where": str(scene.root.resolve()) if scene.root else ""},
    "a held-out view's own loader": lambda scene: [scene.test_views[0].load],
    "another view deep inside": lambda scene: SimpleNamespace(kept=({0: scene.views},)),
    "an image in memory": lambda scene: scene.test_views[0].load(),
    "true depth or masks of a training view": lambda scene: (
        scene.train_views[0].load_depth or scene.train_views[0].load_moving
    ),
}


def _with_default(folder: Path):
    def read(name: str, below: Path = folder) -> Path:
        return below / name

    return read


@pytest.mark.parametrize("way", BAD)
def test_control_what_is_badly_hidden_is_found(scene, way):
    files, tensors = secrets(scene)
    hidden = scene.for_training()
    kept = BAD[way](scene)
    first = hidden.train[0]

    def load(inner=hidden.views[first].load) -> Tensor:
        return inner() if kept is not None else torch.zeros(1)

    views = list(hidden.views)
    views[first] = replace(views[first], load=load)
    assert leaks(replace(hidden, views=tuple(views)), files, tensors)


def test_training_views_keep_what_trains_and_lose_the_truth(scene):
    hidden = scene.for_training()
    assert (hidden.root, hidden.sources) == (None, ())
    assert [view.name for view in hidden.views] == [view.name for view in scene.views]
    for view, whole in zip(hidden.train_views, scene.train_views, strict=True):
        kept = (
            "load",
            "load_mask",
            "load_sky",
            "load_sweep",
            "sweep_time",
            "time",
            "sensor",
            "camera",
        )
        for name in kept:
            assert getattr(view, name) is getattr(whole, name)
        assert (view.load_depth, view.load_moving) == (None, None)
    assert any(view.load_sweep for view in hidden.train_views)


def test_other_views_are_cameras_without_an_image(scene):
    for view, whole in zip(scene.for_training().test_views, scene.test_views, strict=True):
        for name in ("name", "camera", "time", "sensor", "appearance"):
            assert getattr(view, name) is getattr(whole, name)
        kept = {name for name in vars(view) if name.startswith("load_") and getattr(view, name)}
        assert not kept
        with pytest.raises(SplatproofError, match=f"view {re.escape(view.name)}: its image is not"):
            view.load()


def test_a_view_in_neither_part_is_hidden_too():
    scene = replace(tiny_scene(), train=(1, 2), test=(0,))
    for index, view in enumerate(scene.for_training().views):
        if index in scene.train:
            assert view.load().shape == (*view.size, 3)
        else:
            with pytest.raises(SplatproofError):
                view.load()


def test_whatever_a_view_has_is_hidden_unless_it_is_known_to_be_shown():
    """A field that is added to View is hidden from rendering until someone decides otherwise."""
    sweep = Sweep(positions=torch.zeros(1, 3), origin=torch.zeros(3, dtype=torch.float64))
    whole: dict[str, Any] = {
        name: (lambda: sweep) for name in View.__dataclass_fields__ if name.startswith("load")
    }
    view = replace(
        tiny_scene().views[0], **whole, time=1.0, sweep_time=0.9, sensor="a", appearance="b"
    )
    shown = view.without_truth()
    same = {
        name for name in View.__dataclass_fields__ if getattr(shown, name) is getattr(view, name)
    }
    assert same == {"name", "camera", "time", "sensor", "appearance"}
