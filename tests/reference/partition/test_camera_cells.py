"""VastGaussian's cells: equal cameras, one owner, and visibility by sampled areas."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.base.errors import DataError
from splatproof.reference.partition import camera_cells as cameras
from splatproof.reference.partition import frustum, ground_frame
from splatproof.reference.partition.boxes import OrientedBox, box_distance
from splatproof.reference.types.camera import Camera, project_points

SEEDS = st.integers(0, 2**16)
D = torch.float64
EYE = torch.eye(3, dtype=D)


def normal(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=D)


def looking_down(x: float, y: float, height: float, size: int = 100) -> Camera:
    """A nadir camera whose image covers `height` by `height` of the ground at z = 0."""
    pose = torch.eye(4, dtype=D)
    pose[:3, :3] = torch.tensor([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor([x, y, height], dtype=D)
    K = torch.tensor([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1]], dtype=D)
    return Camera(K=K, world_to_camera=pose, width=size, height=size)


@settings(max_examples=40)
@given(
    columns=st.integers(1, 4), rows=st.integers(1, 3), extra=st.integers(0, 30), seed=SEEDS,
    tied=st.booleans(),
)  # fmt: skip
def test_cells_hold_equally_many_cameras_and_everything_has_one_owner(
    columns, rows, extra, seed, tied
):
    centres = normal(columns * rows + extra, 2, seed=seed)
    centres = centres.round() if tied else centres
    grid = cameras.camera_grid(centres, columns, rows)
    assert grid.shape == (columns, rows)
    counts = cameras.owner_cell(grid, centres).bincount(minlength=columns * rows).tolist()
    assert sum(counts) == len(centres)
    if not tied:  # each column has floor(v / m) cameras, each of its rows floor(that / n)
        each = len(centres) // columns
        for column in range(columns):
            held = each if column < columns - 1 else len(centres) - each * (columns - 1)
            want = [held // rows] * (rows - 1) + [held - held // rows * (rows - 1)]
            assert counts[column * rows : (column + 1) * rows] == want
    far = 1e6 * normal(50, 2, seed=seed + 1)
    owners = cameras.owner_cell(grid, far)
    assert ((owners >= 0) & (owners < columns * rows)).all()


def test_cells_by_hand():
    centres = torch.tensor([[0.0, 5], [1, 1], [2, 3], [3, 0], [4, 2], [5, 9], [6, 4]], dtype=D)
    grid = cameras.camera_grid(centres, 2, 2)
    # By x: 3 cameras (0 1 2), then 4 (3 4 5 6). By y: 1 | 3 5, and 0 2 | 4 9.
    assert grid.column_walls.tolist() == [0, 2, 6]
    assert grid.row_walls.tolist() == [[1, 1, 5], [0, 2, 9]]
    assert cameras.owner_cell(grid, centres).tolist() == [1, 0, 1, 2, 2, 3, 3]
    assert grid.cell(3).tolist() == [[2, 2], [6, 9]]
    probes = torch.tensor([[-99.0, -99], [2, 1], [2.1, 2], [99, 99]], dtype=D)
    assert cameras.owner_cell(grid, probes).tolist() == [0, 0, 2, 3]
    # Widened by 0.2 of 4 and of 7: x from 1.2 to 6.8, y from 0.6 to 10.4.
    edge = torch.tensor([[1.3, 0.7], [1.1, 5], [6.7, 10.3], [5, 0.5]], dtype=D)
    assert cameras.in_widened_cell(grid, 3, edge).tolist() == [True, False, True, False]
    assert cameras.in_widened_cell(grid, 3, edge, margin=0.0).tolist() == [False] * 4


def test_fewer_cameras_than_cells_are_refused():
    with pytest.raises(DataError, match="6 cameras"):
        cameras.camera_grid(normal(6, 2, seed=0), 4, 2)


def sampled_share(camera: Camera, box: OrientedBox, grid: int) -> float:
    """Share of a lattice of pixels whose ray meets the box (slab test)."""
    step = (torch.arange(grid, dtype=D) + 0.5) / grid
    x, y = torch.meshgrid(step * camera.width, step * camera.height, indexing="ij")
    pixels = torch.stack([x.flatten(), y.flatten(), torch.ones(grid * grid, dtype=D)], dim=1)
    rays = pixels @ torch.linalg.inv(camera.K).T @ camera.rotation  # z of each is 1 in the camera
    start = (camera.centre - box.centre) @ box.rotation.T / box.half
    along = rays @ box.rotation.T / box.half
    a, b = (-1 - start) / along, (1 - start) / along
    enter = torch.minimum(a, b).amax(dim=1).clamp(min=camera.near)
    leave = torch.maximum(a, b).amin(dim=1)
    return float((enter < leave).double().mean())


@settings(max_examples=60)
@given(seed=SEEDS, near=st.booleans())
def test_image_share_is_that_of_the_rays_that_meet_the_box(seed, near):
    q, w = (
        torch.linalg.qr(normal(3, 3, seed=seed))[0],
        torch.linalg.qr(normal(3, 3, seed=seed + 1))[0],
    )
    spread = 0.5 if near else 3.0  # near: often inside the box, or with corners behind the camera
    pose = torch.eye(4, dtype=D)
    pose[:3, :3] = w * torch.linalg.det(w)
    pose[:3, 3] = spread * normal(3, seed=seed + 2) + torch.tensor([0.0, 0, 1])
    K = torch.tensor([[60.0, 0, 35], [0, 55, 20], [0, 0, 1]], dtype=D)
    camera = Camera(K=K, world_to_camera=pose, width=64, height=48)
    half = normal(3, seed=seed + 3).abs() + 0.2
    box = OrientedBox(centre=torch.zeros(3, dtype=D), rotation=q * torch.linalg.det(q), half=half)
    share = frustum.image_share(camera, box)
    lattice = 64
    # The border of a convex region crosses at most 4 * lattice squares, each wrong by at most 1.
    assert abs(share - sampled_share(camera, box, lattice)) <= 4 / lattice
    assert 0 <= share <= 1 + 1e-12


def test_image_share_by_hand():
    # 20 above z = 0 the image covers 20 x 20; a plate of 5 x 10 at the ground fills 1/8 of it.
    plate = OrientedBox(
        centre=torch.zeros(3, dtype=D), rotation=EYE, half=torch.tensor([2.5, 5, 1e-8], dtype=D),
    )  # fmt: skip
    assert frustum.image_share(looking_down(0, 0, 20), plate) == pytest.approx(1 / 8)
    assert frustum.image_share(looking_down(90, 0, 20), plate) == 0
    # Moved so that half of the plate leaves the image at its border.
    assert frustum.image_share(looking_down(10, 0, 20), plate) == pytest.approx(1 / 16)


def test_a_camera_inside_the_box_sees_nothing_but_the_box():
    cube = OrientedBox(
        centre=torch.zeros(3, dtype=D), rotation=EYE, half=torch.full((3,), 9.0).double()
    )
    assert frustum.image_share(looking_down(1, 2, 3), cube) == pytest.approx(1)


def test_what_lies_before_the_near_plane_does_not_count():
    # From 20 above z = 0, a cube of half 1 around z = 15 lies 4 to 6 away, its top edge 2 wide.
    cube = OrientedBox(
        centre=torch.tensor([0.0, 0, 15], dtype=D), rotation=EYE, half=torch.ones(3, dtype=D)
    )
    camera = looking_down(0, 0, 20)
    for near, side in ((0.01, 2 / 4), (5.0, 2 / 5), (6.5, 0)):
        cut = replace(camera, near=near)
        assert frustum.image_share(cut, cube) == pytest.approx(side**2)


def test_a_box_behind_the_camera_is_not_mirrored_to_the_front():
    above = OrientedBox(
        centre=torch.tensor([0.0, 0, 40], dtype=D), rotation=EYE, half=torch.ones(3, dtype=D)
    )
    assert frustum.image_share(looking_down(0, 0, 20), above) == 0


@pytest.mark.parametrize(
    "points", [[], [[0, 0]], [[0, 0], [1, 1]], [[0, 0], [1, 1], [2, 2], [3, 3]], [[1, 1]] * 5]
)
def test_flat_hulls_have_no_area(points):
    assert frustum.hull_area(torch.tensor(points).double().reshape(-1, 2).numpy()) == 0


def test_a_hull_by_hand():
    triangle = torch.tensor([[0.0, 0], [4, 0], [0, 3], [1, 1]]).double()
    assert frustum.hull_area(triangle.numpy()) == pytest.approx(6)


def test_the_airspace_reaches_from_the_ground_to_the_highest_point():
    cell = torch.tensor([[0.0, 0], [4, 2]], dtype=D)
    heights = torch.linspace(0, 10, 101, dtype=D)
    box = cameras.airspace(EYE, cell, heights)
    assert box is not None
    assert_close(box.centre, torch.tensor([2.0, 1, 5], dtype=D))
    assert_close(box.half, torch.tensor([2.0, 1, 4.9], dtype=D))  # 1 % of the heights on each side
    assert cameras.airspace(EYE, cell, heights[:0]) is None
    assert cameras.airspace(EYE, cell, heights[:1]) is None
    assert cameras.airspace(EYE, cell[:1].repeat(2, 1), heights) is None


def test_selection_by_position_visibility_and_coverage():
    # Cell 0 spans 0 to 4 on both axes, widened -0.8 to 4.8. The third camera stands beside it at
    # x = 5 and sees x from 1 to 9, y from -2 to 6 of the ground: 3.8 * 5.6 of its 64 (and more of
    # what is higher) are the cell. The fourth sees nothing of it.
    centres = torch.tensor([[0.0, 0], [4, 4], [5, 2], [40, 2]], dtype=D)
    views = tuple(looking_down(x, y, 8.0) for x, y in centres.tolist())
    grid = cameras.camera_grid(centres, 2, 1)
    ground = torch.tensor([[0.5, 1, 0], [3, 2, 1], [8, 2, 0], [30, 0, 0]], dtype=D)
    found = cameras.select(grid, 0, EYE, views, ground)
    assert found.views.tolist() == [True, True, True, False]
    # Point 2 lies outside the widened cell but in the added camera's image; point 3 in neither.
    assert found.points.tolist() == [True, True, True, False]
    pixel, _ = project_points(views[2], ground)
    assert 0 <= float(pixel[2, 0]) <= 100


def test_without_points_only_position_decides():
    views = tuple(looking_down(float(x), float(x % 2), 4.0) for x in range(4))
    centres = torch.tensor([[float(x), float(x % 2)] for x in range(4)], dtype=D)
    found = cameras.select(
        cameras.camera_grid(centres, 2, 1), 0, EYE, views, torch.zeros(0, 3, dtype=D)
    )
    assert found.views.tolist() == [True, True, False, False]
    assert found.points.shape == (0,)


@settings(max_examples=30)
@given(seed=SEEDS, count=st.integers(0, 20))
def test_the_ground_frame_is_a_rotation_with_its_third_axis_up(seed, count):
    up = normal(3, seed=seed)
    up = up / up.norm()
    frame = ground_frame.ground_frame(up, normal(count, 3, seed=seed + 1))
    assert_close(frame @ frame.T, EYE)
    assert float(torch.linalg.det(frame)) == pytest.approx(1)
    assert_close(frame[2], up)


def test_the_ground_frame_follows_the_flight():
    angle = math.radians(30)
    along = torch.tensor([math.cos(angle), math.sin(angle), 0], dtype=D)
    flight = torch.linspace(-5, 5, 11, dtype=D)[:, None] * along + 0.1 * normal(11, 3, seed=0)
    flight = flight + 1000 * torch.tensor([-along[1], along[0], 0])  # far from the origin
    frame = ground_frame.ground_frame(EYE[2], flight)
    assert abs(float(frame[0] @ along)) > 0.999


@settings(max_examples=20)
@given(seed=SEEDS)
def test_an_airspace_lies_over_its_cell_in_any_frame(seed):
    up = normal(3, seed=seed)
    frame = ground_frame.ground_frame(up / up.norm(), normal(5, 3, seed=seed + 1))
    heights = torch.linspace(0, 8, 101, dtype=D)  # 1st and 99th percentile: 0.08 and 7.92
    box = cameras.airspace(frame, torch.tensor([[1.0, 2], [5, 4]], dtype=D), heights)
    assert box is not None
    upright = torch.tensor([[3.0, 3, 4], [5, 3, 4], [3, 2, 4], [7, 3, 4]], dtype=D)
    assert_close(box_distance(box, upright @ frame), torch.tensor([0.0, 1, 1, 2], dtype=D))
