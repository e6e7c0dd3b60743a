"""KITTI's labels: tracklet_labels.xml of raw drives, label_02 of tracking sequences."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from splatproof.base.errors import DataError
from splatproof.datasets.adapters import driving
from splatproof.datasets.boxes import Box

TYPES = {
    **dict.fromkeys(("Car", "Van", "Truck", "Tram"), "vehicles"),
    **dict.fromkeys(
        ("Pedestrian", "Person", "Person_sitting", "Person (sitting)", "Cyclist"), "people"
    ),
    **dict.fromkeys(("Misc", "DontCare"), ""),
}
"""KITTI's types and their kinds, cyclists with people as OmniRe has them; "": left out."""
COLUMNS = 17
"""Columns of a line of label_02; an eighteenth, the score, is allowed."""
Motions = Sequence[Float64[np.ndarray, "4 4"]]


def read_labels(path: Path, to_scene: Motions) -> list[Box]:
    """Boxes of a tracking sequence.

    A line has frame, track, type, truncation, occlusion, alpha, 4 image coordinates, height, width,
    length, the middle of the bottom in the rectified frame of camera 0, and the turn about its y axis;
    at turn 0 a thing looks along x.

    Args:
        path: The file.
        to_scene: Motion of each frame, from the rectified frame of camera 0 to the scene's frame.
    Raises: DataError naming file and line.
    Source: KITTI tracking benchmark, devkit readme.
    """
    boxes = []
    for number, line in enumerate(driving.read_text(path).splitlines(), start=1):
        try:
            boxes.append(_label(line.split(), to_scene))
        except (ValueError, KeyError, IndexError):
            raise DataError(
                f"{path}: line {number} is no label of a frame from 0 to {len(to_scene) - 1}; expected "
                f"frame, track, a known type and {COLUMNS - 3} numbers"
            ) from None
    return [box for box in boxes if box is not None]


def _label(words: list[str], to_scene: Motions) -> Box | None:
    """The box of a line, None for a type that is left out. Raises: ValueError, KeyError, IndexError."""
    if len(words) not in (COLUMNS, COLUMNS + 1) or int(words[0]) < 0:
        raise ValueError
    frame, kind = int(words[0]), TYPES[words[2]]
    height, width, length, x, y, z, turn = map(float, words[10:COLUMNS])
    motion = to_scene[frame]
    if not kind:
        return None
    if not np.isfinite([height, width, length, x, y, z, turn]).all():
        raise ValueError
    c, s = np.cos(turn), np.sin(turn)
    ahead, up = np.array([c, 0.0, -s]), np.array([0.0, -1.0, 0.0])
    local = np.eye(4)
    local[:3, :3] = np.stack([ahead, np.cross(up, ahead), up], axis=1)
    local[:3, 3] = np.array([x, y, z]) + up * height / 2
    return Box(
        track=words[1], kind=kind, frame=frame, pose=motion @ local, size=(length, width, height)
    )


def read_tracklets(path: Path, to_scene: Motions) -> list[Box]:
    """Boxes of a raw drive.

    A tracklet has objectType, h, w, l, first_frame, and a pose a frame: tx, ty, tz, the middle of the
    bottom in the LiDAR's frame, and rz, the turn about its z axis.

    Args:
        path: The file.
        to_scene: Motion of each frame, from the LiDAR's frame to the scene's frame.
    Raises: DataError naming the file and the tracklet.
    Source: Geiger et al. 2013, devkit: readTracklets.
    """
    try:
        items = ET.fromstring(driving.read_text(path)).findall("tracklets/item")
    except ET.ParseError as error:
        raise DataError(f"{path}: not an XML file ({error})") from None
    boxes = []
    for number, item in enumerate(items):
        try:
            kind = TYPES[item.findtext("objectType", "")]
            length, width, height = (_value(item, name) for name in "lwh")
            first = int(_value(item, "first_frame"))
            poses = [
                [_value(pose, name) for name in ("tx", "ty", "tz", "rz")]
                for pose in item.findall("poses/item")
            ]
            if first < 0 or not poses:
                raise ValueError
        except (ValueError, KeyError):
            raise DataError(
                f"{path}: tracklet {number} is not one of KITTI's; expected objectType, h, w, l, "
                "first_frame and poses with tx, ty, tz, rz"
            ) from None
        # tracklets may go on beyond the last photo
        for frame, (x, y, z, turn) in enumerate(poses[: len(to_scene) - first], start=first):
            if kind:
                c, s = np.cos(turn), np.sin(turn)
                local = np.array(
                    [[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z + height / 2], [0, 0, 0, 1.0]]
                )
                pose, size = to_scene[frame] @ local, (length, width, height)
                boxes.append(Box(track=str(number), kind=kind, frame=frame, pose=pose, size=size))
    return boxes


def _value(item: ET.Element, name: str) -> float:
    """A finite number. Raises: ValueError."""
    value = float(item.findtext(name, "nan"))
    if not np.isfinite(value):
        raise ValueError
    return value
