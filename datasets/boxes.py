"""Boxes around things in a drive, in the scene's frame, and the pixels that those in motion cover."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64
from skimage.draw import polygon2mask

SPEED = 1.0
"""Metres a second above which a thing moves: as drivestudio exports Waymo's masks."""
REACH = 0.5
"""Seconds before and after a frame over which the speed is taken: boxes jitter by decimetres."""
NEAR = 0.1
"""Metres before the camera at which a box is cut off."""
EDGES = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]
"""Pairs of corners that an edge joins; bits of a corner's index: front, left, top."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A thing at one moment."""

    track: str
    """Name of the thing, the same at all moments."""
    kind: str
    """One of splatproof.datasets.moving_masks.KINDS."""
    frame: int
    """Index of the moment."""
    pose: Float64[np.ndarray, "4 4"]
    """Box to scene: x ahead, y left, z up, the origin in the middle."""
    size: tuple[float, float, float]
    """Length, width and height in metres."""

    @property
    def corners(self) -> Float64[np.ndarray, "8 3"]:
        """Corner i is in front where i has bit 1, left where it has bit 2, on top where bit 4."""
        signs = np.array([[(i >> axis & 1) - 0.5 for axis in range(3)] for i in range(8)])
        return signs * self.size @ self.pose[:3, :3].T + self.pose[:3, 3]


def in_motion(boxes: Iterable[Box], times: Sequence[float]) -> list[Box]:
    """The boxes of things that move faster than SPEED.

    The speed is that of the middle between the first and the last moment within REACH of the box's
    own at which its track is known; of a track that is known at one moment alone it is 0.

    Args:
        boxes: All boxes of a drive, in any order.
        times: Time of each moment in seconds; a box's `frame` is an index into them.
    Source: threshold of drivestudio's waymo_preprocess.py; KITTI states no speeds, so taken from the
        boxes: ours.
    """
    tracks: dict[str, list[Box]] = defaultdict(list)
    for box in boxes:
        tracks[box.track].append(box)
    moving = []
    for track in tracks.values():
        track.sort(key=lambda box: box.frame)
        for box in track:
            near = [b for b in track if abs(times[b.frame] - times[box.frame]) <= REACH + 1e-6]
            seconds = times[near[-1].frame] - times[near[0].frame]
            metres = float(np.linalg.norm(near[-1].pose[:3, 3] - near[0].pose[:3, 3]))
            if seconds > 0 and metres > SPEED * seconds:
                moving.append(box)
    return moving


def covered(
    boxes: Iterable[Box],
    K: Float64[np.ndarray, "3 3"],
    world_to_camera: Float64[np.ndarray, "4 4"],
    size: tuple[int, int],
) -> Bool[np.ndarray, "h w"]:
    """Pixels whose centres lie within the outline of a box; what stands before it is not cut out.

    Args:
        boxes: Boxes of one moment, in the scene's frame.
        K: Intrinsics of a pinhole camera, in pixels.
        world_to_camera: Pose of that camera, OpenCV axes.
        size: (width, height).
    """
    mask = np.zeros(size[::-1], dtype=bool)
    for box in boxes:
        outline = box_outline(box, K, world_to_camera)
        if len(outline):
            # row before column, and centres lie at whole numbers
            mask |= polygon2mask(mask.shape, outline[:, ::-1] - 0.5)
    return mask


def box_outline(
    box: Box, K: Float64[np.ndarray, "3 3"], world_to_camera: Float64[np.ndarray, "4 4"]
) -> Float64[np.ndarray, "n 2"]:
    """Convex outline in pixels of the part of a box that lies before the camera; may be empty.

    Args:
        box: A box in the scene's frame.
        K: Intrinsics of a pinhole camera, in pixels.
        world_to_camera: Pose of that camera, OpenCV axes.
    """
    local = box.corners @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    ends = [(local[a], local[b]) for a, b in EDGES]
    cuts = [
        a + (b - a) * (NEAR - a[2]) / (b[2] - a[2])
        for a, b in ends
        if (a[2] - NEAR) * (b[2] - NEAR) < 0
    ]
    ahead = np.array([*local[local[:, 2] >= NEAR], *cuts]).reshape(-1, 3)
    pixels = ahead @ K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    if len(pixels) < 3:
        return np.zeros((0, 2))
    hull = np.asarray(cv2.convexHull(pixels.astype(np.float32), returnPoints=False), np.int64)
    return pixels[hull[:, 0]]
