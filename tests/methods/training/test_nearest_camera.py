"""The nearest training camera: against one look after the other, and at a camera itself."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.tiny_scene import camera
from splatproof.methods.training.nearest_camera import NearestCamera
from splatproof.reference.types.scene import camera_view

CAMERAS = tuple(camera(index) for index in range(4))
CENTRES = torch.stack([one.centre for one in CAMERAS])
NEAREST = NearestCamera([camera_view(one) for one in CAMERAS])


@given(count=st.integers(1, 30), seed=st.integers(0, 999), spread=st.floats(0.01, 100))
def test_it_is_the_nearest_of_all(count, seed, spread):
    generator = torch.Generator().manual_seed(seed)
    means = spread * torch.randn(count, 3, generator=generator)
    distance, rays = NEAREST.look(means)
    for mean, far, ray in zip(means.double(), distance, rays, strict=True):
        apart = (CENTRES - mean).norm(dim=1)
        torch.testing.assert_close(far, apart.min())
        torch.testing.assert_close(CENTRES[apart.argmin()] + far * ray, mean, rtol=0, atol=1e-9)


def test_on_a_camera_there_is_no_ray():
    distance, rays = NEAREST.look(CENTRES[2:3])
    assert float(distance) == 0
    assert torch.equal(rays, torch.zeros(1, 3, dtype=torch.float64))
