"""A strip of consecutive moments of a drive, a line a row: photos above, what each row's model makes of them below."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from strips import QUALITY, Crop, Image, crops, line_of, tile_of

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.loading import load_reconstruction
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.held_out import drawn, to_8_bit

BESIDE = 2
"""Moments shown on either side of a held-out one: five in all."""
WIDTH = 270
"""Pixels that a view is wide."""


def draw_moments(
    path: Path, scene: str, protocol: Protocol, folders: Mapping[str, Path], sensor: str
) -> None:
    """Write a strip of one camera of a drive, where the runs have the models of all its rows.

    Args:
        path: JPEG that is written.
        scene: Name of a scene whose views know their time and camera.
        protocol: Which of its moments are held out.
        folders: A case's folder by row.
        sensor: Name of the camera.
    """
    if not all((folder / "model").is_dir() for folder in folders.values()):
        return
    opened = open_scene(scene, protocol)
    views = moments(opened, sensor)
    held = {view.name for view in opened.test_views}
    # the same part of all, round what moves in the middle one: a car is seen to drive through it
    crop = crops([views[BESIDE]])[0]
    titles = [f"{view.time:.1f} s{', held out' if view.name in held else ''}" for view in views]
    lines = [
        np.hstack([line_of(title, WIDTH) for title in titles]),
        _line([to_8_bit(view.load()) for view in views], crop),
    ]
    for row, folder in folders.items():
        model = load_reconstruction(folder / "model")
        shown = [to_8_bit(drawn(view, opened.train_views, model, protocol)) for view in views]
        lines += [line_of(row, WIDTH * len(views)), _line(shown, crop)]
    cv2.imwrite(str(path), np.vstack(lines), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def moments(scene: Scene, sensor: str) -> list[View]:
    """One camera's views of that held-out moment, and of those round it, in which most of its image moves.

    Args:
        scene: Views with time and sensor, some of them held out.
        sensor: Name of the camera.
    Returns: 2 BESIDE + 1 views in the order of time, the held-out one in the middle.
    """
    views = sorted(
        (view for view in scene.views if view.sensor == sensor), key=lambda v: v.time or 0.0
    )
    held = {view.name for view in scene.test_views}
    middle = max(
        (i for i in range(BESIDE, len(views) - BESIDE) if views[i].name in held),
        key=lambda i: _moving_pixels(views[i]),
    )
    return views[middle - BESIDE : middle + BESIDE + 1]


def _moving_pixels(view: View) -> int:
    masks = view.load_moving() if view.load_moving else {}
    return sum(int(mask.sum()) for mask in masks.values())


def _line(images: Sequence[Image], crop: Crop) -> Image:
    """Images of RGB side by side, as BGR."""
    return np.hstack([tile_of(image[..., ::-1], crop, WIDTH) for image in images])
