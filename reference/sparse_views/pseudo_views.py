"""Pseudo views: cameras that took no photo, between those that did."""

from dataclasses import replace

import torch
from scipy.spatial.transform import Rotation

from splatproof.reference.types.camera import Camera


def between(first: Camera, second: Camera, share: float) -> Camera:
    """The camera a share of the way: centre on the segment, rotation on the shortest arc.

    R(s) = exp(s log(R_2 R_1^T)) R_1 and c(s) = (1 - s) c_1 + s c_2, with the first one's intrinsics.

    Args:
        first: Where share 0 stands.
        second: Where share 1 stands.
        share: In [0, 1].

    Source: ours; the releases of FSGS and CoR-GS draw positions round an average pose, which suits
        cameras that look ahead.
    """
    start = Rotation.from_matrix(first.rotation.double().numpy())
    turn = Rotation.from_matrix(second.rotation.double().numpy()) * start.inv()
    way = Rotation.from_rotvec(share * turn.as_rotvec()) * start
    rotation = torch.from_numpy(way.as_matrix())
    centre = (1 - share) * first.centre.double() + share * second.centre.double()
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return replace(first, world_to_camera=pose.to(first.world_to_camera))
