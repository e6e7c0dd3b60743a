"""Adapter reel: a folder with photos, reel.csv (a camera and a time a photo) and points.csv."""

import csv
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.datasets.adapters.posed import checked_pose, pinhole_camera
from splatproof.datasets.assemble import open_layout
from splatproof.datasets.catalogue.opening import Adapter
from splatproof.datasets.layout import Layout, PosedPhoto, plain_points
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

INDEX, POINTS = "reel.csv", "points.csv"


def open_reel(folder: Path, protocol: Protocol) -> Scene:
    """The scene of a folder.

    Args:
        folder: With reel.csv: name, width, height, focal length in pixels, 12 numbers of the
            camera-to-world matrix, seconds; points.csv: x, y, z.
        protocol: Sizes and split.

    Raises: DataError naming file and line.
    """
    index = folder / INDEX
    photos = []
    with index.open(newline="", encoding="utf-8") as file:
        for number, line in enumerate(csv.reader(file), 1):
            where = f"{index}: line {number}"
            try:
                name, numbers = line[0], [float(text) for text in line[1:]]
                width, height, focal, *pose, seconds = numbers
                matrix = np.array(pose).reshape(3, 4)
            except (ValueError, IndexError):
                raise DataError(f"{where}: expected a name and 16 numbers, found {line}") from None
            photos.append(
                PosedPhoto(
                    name=name, path=folder / name, time=seconds,
                    camera=pinhole_camera(
                        int(width), int(height), focal, focal, width / 2, height / 2
                    ),
                    camera_to_world=checked_pose(matrix, where),
                )
            )  # fmt: skip
    places = np.loadtxt(folder / POINTS, delimiter=",", ndmin=2)
    grey = np.full((len(places), 3), 128, np.uint8)
    layout = Layout(
        adapter="reel", photos=photos, description=(index, folder / POINTS),
        points=plain_points(places, grey),
    )  # fmt: skip
    return open_layout(folder, layout, protocol)


ADAPTER = Adapter(
    name="reel", looks_for=f"{INDEX} and {POINTS}, photos beside them",
    recognises=lambda folder: (folder / INDEX).is_file(), open=open_reel,
)  # fmt: skip
