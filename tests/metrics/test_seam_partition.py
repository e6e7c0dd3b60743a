"""The seam mask of a partition on a plane, where the rim's width can be worked out by hand."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.methods.city.voxel_region import VoxelRegion
from splatproof.metrics.seam_partition import partition_seam_mask, surface_points
from splatproof.reference.partition.boxes import OrientedBox
from splatproof.reference.rasterizer.rotation import rotation_matrix
from splatproof.reference.types.camera import Camera, project_points

WIDTH, HEIGHT, DEPTH = 80, 60, 10.0


def nadir(turn: float = 0.0) -> Camera:
    """Looks down z from 10 units at the plane z = 10; a pixel is 0.1 units wide there."""
    pose = torch.eye(4, dtype=torch.float64)
    half = torch.tensor([math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)], dtype=torch.float64)
    pose[:3, :3] = rotation_matrix(half[None])[0]
    K = torch.tensor([[100.0, 0, 40], [0, 100, 30], [0, 0, 1]], dtype=torch.float64)
    return Camera(K=K, world_to_camera=pose, width=WIDTH, height=HEIGHT)


def box(x: float, half: float = 2.0) -> OrientedBox:
    """As wide as `half` along x around x, and endless along y and z."""
    return OrientedBox(
        centre=torch.tensor([x, 0.0, DEPTH], dtype=torch.float64),
        rotation=torch.eye(3, dtype=torch.float64),
        half=torch.tensor([half, 50.0, 50.0], dtype=torch.float64),
    )


def flat(value: float = DEPTH) -> torch.Tensor:
    return torch.full((HEIGHT, WIDTH), value)


def test_two_boxes_that_touch_share_a_rim_of_a_tenth_of_their_halves():
    mask = partition_seam_mask(nadir(), flat(), (box(-2.0), box(2.0)))
    columns = torch.where(mask.any(dim=0))[0]
    # |X| <= 0.1 * 2 units: pixels of 0.1 units, centres at +-0.05 and +-0.15
    assert columns.tolist() == [38, 39, 40, 41]
    assert mask[:, columns].all()


def test_a_camera_that_flies_on_sees_the_seam_where_it_was():
    mask = partition_seam_mask(moved(nadir(), (1.0, 0.0, 0.0)), flat(), (box(-2.0), box(2.0)))
    assert torch.where(mask.any(dim=0))[0].tolist() == [28, 29, 30, 31]


def test_a_gap_wider_than_the_rims_has_no_seam_and_a_third_box_changes_nothing_elsewhere():
    apart = partition_seam_mask(nadir(), flat(), (box(-2.3), box(2.3)))
    assert not apart.any()
    two = partition_seam_mask(nadir(), flat(), (box(-2.0), box(2.0)))
    far = partition_seam_mask(nadir(), flat(), (box(-2.0), box(2.0), box(100.0)))
    assert torch.equal(two, far)


def test_one_region_none_and_sky_have_no_seam():
    assert not partition_seam_mask(nadir(), flat(), ()).any()
    assert not partition_seam_mask(nadir(), flat(), (box(0.0),)).any()
    for nothing in (math.inf, 0.0, math.nan):
        assert not partition_seam_mask(nadir(), flat(nothing), (box(-2.0), box(2.0))).any()


@settings(deadline=None, max_examples=20)
@given(st.permutations([-4.0, 0.0, 4.0]))
def test_order_of_regions_does_not_matter(order):
    want = partition_seam_mask(nadir(), flat(), (box(-4.0), box(0.0), box(4.0)))
    assert torch.equal(partition_seam_mask(nadir(), flat(), [box(x) for x in order]), want)


def moved(camera: Camera, by: tuple[float, float, float]) -> Camera:
    """The camera at another place."""
    pose = camera.world_to_camera.clone()
    pose[:3, 3] -= pose[:3, :3] @ torch.tensor(by, dtype=torch.float64)
    return replace(camera, world_to_camera=pose)


@settings(deadline=None, max_examples=10)
@given(turn=st.floats(-3, 3), by=st.tuples(*[st.floats(-5, 5)] * 3), seed=st.integers(0, 99))
def test_surface_points_project_back_to_pixel_centres(turn, by, seed):
    depth = 1 + 9 * torch.rand(HEIGHT, WIDTH, generator=torch.Generator().manual_seed(seed))
    camera = moved(nadir(turn), by)
    points = surface_points(camera, depth)
    pixels, z = project_points(camera, points.reshape(-1, 3))
    assert z.reshape(HEIGHT, WIDTH).numpy() == pytest.approx(depth.double().numpy(), rel=1e-12)
    assert pixels[WIDTH + 3].tolist() == pytest.approx([3.5, 1.5], abs=1e-9)


def test_regions_of_voxels_are_asked_what_their_distance_says():
    grid = torch.zeros(8, 6, 3, dtype=torch.bool)
    grid[:4, :, :] = True
    grid[3, 2:, :] = False
    parts = (grid[:4], ~grid)
    parts = (parts[0], parts[1][3:])
    regions = [
        VoxelRegion(
            frame=torch.eye(3, dtype=torch.float64),
            low=torch.tensor([low, -3.0, DEPTH - 1.5], dtype=torch.float64),
            side=1.0,
            cells=cells,
        )
        for low, cells in ((-4.0, parts[0]), (-1.0, parts[1]))
    ]
    points = surface_points(nadir(), flat()).reshape(-1, 3)
    want = torch.stack([region.distance(points) <= 1.1 for region in regions]).sum(dim=0) >= 2
    found = partition_seam_mask(nadir(), flat(), regions)
    assert torch.equal(found.reshape(-1), want)
    assert 0.02 < float(found.float().mean()) < 0.3
