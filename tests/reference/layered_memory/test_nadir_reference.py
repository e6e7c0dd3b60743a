import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from splatproof.reference.layered_memory import layered_depth as ldi
from splatproof.reference.layered_memory.nadir_reference import nadir_reference
from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.supervision.spiral_path import look_at
from splatproof.reference.types.camera import Camera

D = torch.float64
UP = torch.tensor([0.0, 0, 1], dtype=D)


def flight(seed: int, up: Tensor, count: int = 3) -> list[Camera]:
    """Oblique views of about the same ground, 20 above it."""
    g = torch.Generator().manual_seed(seed)
    cameras = []
    for _ in range(count):
        eye = torch.randn(3, generator=g, dtype=D) * 5 + 20 * up
        target = torch.randn(3, generator=g, dtype=D) * 4
        K = torch.tensor([[40.0, 0, 16], [0, 40.0, 12], [0, 0, 1]], dtype=D)
        cameras.append(Camera(K=K, world_to_camera=look_at(eye, target, up), width=32, height=24))
    return cameras


def depths_of(camera: Camera, seed: int) -> Tensor:
    noise = torch.rand(24, 32, generator=torch.Generator().manual_seed(seed), dtype=D)
    return (0.6 + 0.7 * noise) * camera.centre.norm()


@given(seed=st.integers(0, 2**16), axis=st.sampled_from([UP, -UP, UP.roll(1), -UP.roll(2)]))
def test_nothing_that_a_view_sees_is_lost(seed, axis):
    cameras = flight(seed, axis)
    maps = [depths_of(camera, seed + i) for i, camera in enumerate(cameras)]
    reference = nadir_reference(cameras, [(float(z.min()), float(z.max())) for z in maps], axis)
    memory = ldi.empty(reference, 0.05)
    for camera, depth in zip(cameras, maps, strict=True):
        memory = ldi.insert(memory, unproject(camera, depth), torch.zeros(768, 3, dtype=D))
    assert (memory.unseen, int(memory.counts.sum())) == (0, 3 * 768)
    assert float(reference.rotation[2] @ axis) == pytest.approx(-1)


def test_a_training_view_as_reference_loses_samples():
    """The control: what the virtual camera is for."""
    cameras = flight(1, UP)
    memory = ldi.empty(cameras[0], 0.05)
    for i, camera in enumerate(cameras[1:]):
        points = unproject(camera, depths_of(camera, i))
        memory = ldi.insert(memory, points, torch.zeros_like(points))
    assert memory.unseen > 0.1 * 2 * 768


def test_pixels_are_as_wide_as_the_views_own():
    """Views that look down from 20 at ground 18 to 22 away: a pixel is 20 / 40 wide there."""
    pose = look_at(20 * UP, 0 * UP, UP)
    K = torch.tensor([[40.0, 0, 16], [0, 40.0, 12], [0, 0, 1]], dtype=D)
    view = Camera(K=K, world_to_camera=pose, width=32, height=24)
    reference = nadir_reference([view] * 3, [(18.0, 22.0)] * 3, UP)
    ground = float((reference.centre - view.centre) @ UP) + 20
    assert ground / float(reference.K[0, 0]) == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("depths", [(0.0, 1.0), (2.0, 1.0), (1.0, float("inf"))])
def test_frusta_without_an_end_are_refused(depths):
    with pytest.raises(ValueError, match="largest depth"):
        nadir_reference(flight(0, UP, 1), [depths], UP)
    with pytest.raises(ValueError, match="need views"):
        nadir_reference([], [], UP)
