"""Cameras between cameras: ends, the way, rigid poses, both directions."""

import math
from dataclasses import replace

import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from splatproof.reference.sparse_views.pseudo_views import between
from splatproof.reference.types.camera import Camera

SHARES = st.floats(0, 1)


def camera(seed: int) -> Camera:
    generator = torch.Generator().manual_seed(seed)
    pose = torch.eye(4, dtype=torch.float64)
    turn = torch.randn(4, generator=generator).double().numpy()
    pose[:3, :3] = torch.from_numpy(Rotation.from_quat(turn).as_matrix())
    pose[:3, 3] = 100 * torch.randn(3, generator=generator).double()
    K = torch.tensor([[50.0, 0, 20], [0, 50, 15], [0, 0, 1]]).double()
    return Camera(K=K, world_to_camera=pose, width=40, height=30)


@given(seed=st.integers(0, 2**16))
def test_the_ends_are_the_cameras(seed):
    one, other = camera(seed), camera(seed + 1)
    for share, want in ((0.0, one), (1.0, other)):
        torch.testing.assert_close(between(one, other, share).world_to_camera, want.world_to_camera)


@given(seed=st.integers(0, 2**16), share=SHARES)
def test_the_pose_is_rigid_on_the_segment_and_the_same_from_the_other_side(seed, share):
    one, other = camera(seed), camera(seed + 1)
    way, back = between(one, other, share), between(other, one, 1 - share)
    eye = torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close(way.rotation @ way.rotation.T, eye)
    torch.testing.assert_close(way.centre, (1 - share) * one.centre + share * other.centre)
    torch.testing.assert_close(way.world_to_camera, back.world_to_camera)


def test_a_share_of_an_angle_by_hand():
    one = camera(0)
    pose = one.world_to_camera.clone()
    spin = Rotation.from_euler("z", 80, degrees=True).as_matrix()
    pose[:3, :3] = torch.from_numpy(spin) @ pose[:3, :3]
    way = between(one, replace(one, world_to_camera=pose), 0.25)
    turn = way.rotation @ one.rotation.T
    assert math.isclose(math.degrees(math.acos((turn.trace() - 1) / 2)), 20, abs_tol=1e-9)
