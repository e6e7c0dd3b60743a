"""Regions: one normalised distance for boxes, rectangles, contracted cells and voxel sets."""

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.base.errors import DataError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.city import partition_regions as blocks
from splatproof.methods.city import regions
from splatproof.methods.city.regions import GroundRegion, OrientedRegion
from splatproof.methods.city.voxel_region import VoxelRegion
from splatproof.methods.storage.deflated import inflated
from splatproof.reference.partition import camera_cells as partition_cameras
from splatproof.reference.partition import contracted_grid as partition_grid
from splatproof.reference.partition import density_split as partition_density
from splatproof.reference.partition import odbp
from splatproof.reference.partition.boxes import OrientedBox, Region, box_distance
from splatproof.reference.partition.odbp import OdbpSettings

D = torch.float64
SEEDS = st.integers(0, 2**16)


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def turn(seed: int) -> Tensor:
    return torch.linalg.qr(torch.randn(3, 3, generator=generator(seed), dtype=D)).Q


def trimmed(cells: Tensor) -> Tensor:
    """The cells within the box around those that are set."""
    index = cells.nonzero()
    low, high = index.amin(dim=0), index.amax(dim=0) + 1
    return cells[low[0] : high[0], low[1] : high[1], low[2] : high[2]]


def voxels(seed: int, size: tuple[int, int, int], share: float) -> VoxelRegion:
    """A random set of voxels in a turned frame."""
    g = generator(seed)
    cells = torch.rand(size, generator=g) < share
    cells[0, 0, 0] = True
    return VoxelRegion(
        frame=turn(seed), low=10 * torch.randn(3, generator=g, dtype=D), side=0.7,
        cells=trimmed(cells),
    )  # fmt: skip


def by_loop(region: VoxelRegion, points: Tensor) -> Tensor:
    """The definition, voxel by voxel; the outside is a layer of voxels ten boxes thick."""
    local = (points @ region.frame.T - region.low) / region.side
    n = torch.tensor(region.cells.shape)
    e = (region.half if region.unit is None else region.unit) / region.side
    padded = torch.nn.functional.pad(region.cells, [1] * 6)
    inner = padded.nonzero() - 1
    outer = (~padded).nonzero() - 1

    def away(p: Tensor, cells: Tensor) -> float:
        low, high = cells.double(), cells.double() + 1
        # a voxel of the layer around reaches to infinity
        low = torch.where(cells < 0, -torch.inf, low)
        high = torch.where(cells >= n, torch.inf, high)
        return float(((low - p).clamp(min=0).maximum(p - high) / e).amax(dim=1).amin())

    found = []
    for p in local:
        to_v = away(p, inner)
        found.append(1 + to_v if to_v > 0 else max(0.0, 1 - away(p, outer)))
    return torch.tensor(found, dtype=D)


@settings(max_examples=30)
@given(
    size=st.tuples(*[st.integers(1, 7)] * 3), share=st.sampled_from([0.05, 0.3, 0.8, 1.0]),
    unit=st.none() | st.tuples(*[st.floats(0.2, 9.0)] * 3), seed=SEEDS,
)  # fmt: skip
def test_the_distance_to_voxels_is_that_of_the_definition(size, share, unit, seed):
    region = voxels(seed, size, share)
    region = replace(region, unit=unit and torch.tensor(unit, dtype=D))
    spread = 2.5 * region.half.max()
    points = region.centre + spread * torch.randn(40, 3, generator=generator(seed + 1), dtype=D)
    found = region.distance(points)
    assert_close(found, by_loop(region, points), rtol=0, atol=1e-12)
    for low, high in ((1.0, 1.2), (0.0, 1.2), (0.9, 3.0)):
        assert torch.equal(region.clipped(points, low, high), found.clamp(low, high))


@settings(max_examples=30)
@given(size=st.tuples(*[st.integers(1, 40)] * 3), seed=SEEDS)
def test_a_full_box_of_voxels_has_the_distance_of_the_box(size, seed):
    region = voxels(seed, size, 1.1)
    box = OrientedBox(centre=region.centre, rotation=region.frame, half=region.half)
    spread = 1.2 * region.half
    local = spread * (2 * torch.rand(300, 3, generator=generator(seed), dtype=D) - 1)
    points = region.centre + local @ region.frame
    assert_close(region.distance(points), box_distance(box, points), rtol=0, atol=1e-12)
    corners = region.centre + region.half * torch.eye(3, dtype=D) @ region.frame
    assert_close(region.distance(corners), box_distance(box, corners), rtol=0, atol=1e-12)


def test_a_missing_voxel_changes_the_distance():
    full = voxels(3, (6, 6, 6), 1.1)
    cells = full.cells.clone()
    cells[3, 3, 3] = False
    at = full.low + (torch.tensor([3.5, 3.5, 3.5], dtype=D)) * full.side
    there = (at @ full.frame)[None]
    # half a voxel from the wall of the hole, of a box of half-extent 3 voxels
    assert float(replace(full, cells=cells).distance(there)[0]) == pytest.approx(1 + 0.5 / 3)
    assert float(full.distance(there)[0]) == pytest.approx(0.5 / 3)


def test_a_given_unit_makes_rims_of_one_width_whatever_else_a_block_has():
    cells = torch.zeros(20, 4, 4, dtype=torch.bool)
    cells[:4] = True
    near, far = cells[:4].clone(), cells.clone()
    far[-1, 0, 0] = True
    made = [
        VoxelRegion(frame=torch.eye(3, dtype=D), low=torch.zeros(3, dtype=D), side=1.0, cells=c)
        for c in (near, far)
    ]
    at = torch.tensor([[-0.3, 2.0, 2.0]], dtype=D)
    assert [float(one.distance(at)) for one in made] == pytest.approx([1.15, 1.03])
    unit = torch.full((3,), 2.0, dtype=D)
    for one in made:
        assert float(replace(one, unit=unit).distance(at)) == pytest.approx(1.15)


def test_odbps_rims_are_of_one_width_or_grow_with_the_box():
    positions, loads = scene(4, 600)
    found = odbp.partition(positions, loads, OdbpSettings(blocks=4, voxel_size=1.0, imbalance=0.2))
    made = blocks.voxel_regions(found, torch.eye(3, dtype=D))
    assert all(torch.equal(cast(Tensor, one.unit), cast(Tensor, made[0].unit)) for one in made)
    assert all(one.unit is None
               for one in blocks.voxel_regions(found, torch.eye(3, dtype=D), rims="block"))  # fmt: skip


def test_beyond_the_bounds_the_nearest_place_counts():
    region = voxels(1, (4, 4, 4), 1.1)
    bounds = torch.stack([region.low, region.low + 2 * region.half])
    far = (region.low + torch.tensor([1e6, -1e6, 1.0], dtype=D)) @ region.frame
    assert float(region.distance(far[None])[0]) > 1.1
    assert float(replace(region, bounds=bounds).distance(far[None])[0]) <= 1 + 1e-12


@pytest.mark.parametrize("cells", [torch.zeros(2, 2, 2).bool(), torch.eye(3).bool()[:2, None]])
def test_voxels_without_a_tight_box_are_refused(cells):
    region = voxels(1, (2, 2, 2), 1.1)
    with pytest.raises(DataError, match="voxels"):
        replace(region, cells=cells)


def scene(seed: int, count: int = 400) -> tuple[Tensor, Tensor]:
    g = generator(seed)
    positions = torch.rand(count, 3, generator=g, dtype=D) * torch.tensor([8.0, 6.0, 2.0])
    return positions, torch.randint(2, 9, (count,), generator=g)


@settings(max_examples=10)
@given(seed=SEEDS, k=st.integers(1, 5), cells=st.sampled_from([2**22, 100]))
def test_odbps_cores_are_its_voxels_and_tile_the_scene(seed, k, cells):
    positions, loads = scene(seed)
    found = odbp.partition(
        positions, loads, OdbpSettings(blocks=k, voxel_size=1.0, imbalance=0.2, seeds=1)
    )
    frame = turn(seed)
    made = blocks.voxel_regions(found, frame, most_cells=cells)
    away = torch.stack([region.distance(positions @ frame) for region in made])
    core = away <= 1
    assert core.any(dim=0).all()
    assert (core.sum(dim=0) == 1).all()  # no point of a random scene lies on a wall
    assert torch.equal(regions.nearest_region(made, positions @ frame), away.argmin(dim=0))
    if cells > 100:  # else voxels are rounded to a coarser grid
        assert torch.equal(away.argmin(dim=0), found.labels)
    anywhere = 50 * torch.randn(200, 3, generator=generator(seed), dtype=D)
    outside = torch.stack([region.distance(anywhere) for region in made])
    assert (outside.amin(dim=0) <= 1 + 1e-9).all()  # open: every place belongs to a core


def test_far_points_do_not_coarsen_the_grid():
    positions, loads = scene(5, 2000)
    positions[0] = torch.tensor([3000.0, -2000.0, 500.0])
    found = odbp.partition(positions, loads, OdbpSettings(blocks=3, voxel_size=0.5))
    made = blocks.voxel_regions(found, torch.eye(3, dtype=D))
    assert max(region.side for region in made) <= 0.5
    assert max(float(region.half.max()) for region in made) < 10
    owner = regions.nearest_region(made, positions)
    assert (owner[1:] == found.labels[1:]).double().mean() > 0.97


def test_closed_blocks_end_with_the_grid():
    positions, loads = scene(2)
    found = odbp.partition(positions, loads, OdbpSettings(blocks=2, voxel_size=1.0, imbalance=0.2))
    made = blocks.voxel_regions(found, torch.eye(3, dtype=D), open_=False)
    far = torch.tensor([[100.0, 0, 0]], dtype=D)
    assert all(float(region.distance(far)[0]) > 1.1 for region in made)


@settings(max_examples=15)
@given(seed=SEEDS, k=st.integers(1, 6))
def test_density_rectangles_own_what_the_reference_says(seed, k):
    positions, _ = scene(seed)
    frame = turn(seed)
    found = partition_density.split(
        positions[:, :2], partition_density.DensitySettings(max_points=0, max_depth=k, max_blocks=k)
    )
    heights = partition_density.height_bounds(positions[:, 2])
    made = blocks.oriented_regions(found, frame, heights)
    owner = partition_density.owner_rectangle(found, positions[:, :2])
    held = regions.nearest_region(made, positions @ frame) == owner
    assert held.double().mean() > 0.98  # the hull's own points lie on the root's border
    closed = blocks.oriented_regions(found, frame, heights, open_=False)
    inside = (positions[:, 2] - sum(heights) / 2).abs() < (heights[1] - heights[0]) / 2
    for region, other in zip(made, closed, strict=True):
        a, b = (r.distance((positions @ frame)[inside]) for r in (region, other))
        assert_close(a, b, rtol=0, atol=1e-9)


@settings(max_examples=15)
@given(seed=SEEDS, columns=st.integers(1, 3), rows=st.integers(1, 2))
def test_camera_cells_own_what_the_reference_says(seed, columns, rows):
    g = generator(seed)
    grid = partition_cameras.camera_grid(torch.rand(30, 2, generator=g, dtype=D), columns, rows)
    frame = turn(seed)
    places = 4 * torch.rand(300, 3, generator=g, dtype=D) - 1.5
    found = regions.nearest_region(blocks.ground_regions(grid, frame), places @ frame)
    want = partition_cameras.owner_cell(grid, places[:, :2])
    assert torch.equal(found, want)  # no random place lies on a wall


@settings(max_examples=15)
@given(seed=SEEDS, cells=st.tuples(*[st.integers(1, 3)] * 3))
def test_contracted_cells_own_what_the_reference_says(seed, cells):
    positions, _ = scene(seed)
    foreground = partition_grid.central_box(positions)
    frame = turn(seed)
    places = torch.cat([positions, 100 * (positions - 4)])
    made = blocks.contracted_regions(foreground, cells, frame)
    want = partition_grid.cell_of(partition_grid.contract(places, foreground), cells)
    away = torch.stack([region.distance(places @ frame) for region in made])
    clear = ((away - 1).abs() > 1e-9).all(dim=0)  # a median, too, lies on the box's middle wall
    assert clear.double().mean() > 0.98
    assert ((away <= 1).sum(dim=0) == 1)[clear].all()
    assert torch.equal(away.argmin(dim=0)[clear], want[clear])


def test_rectangles_are_infinitely_high():
    corners = torch.tensor([[0.0, 0.0], [2.0, 4.0]], dtype=D)
    region = GroundRegion(frame=torch.eye(3, dtype=D), corners=corners)
    points = torch.tensor([[1.0, 2, 0], [1, 2, 1e9], [2, 2, 5], [1, 4.4, -7]], dtype=D)
    assert region.distance(points).tolist() == pytest.approx([0, 0, 1, 1.2])
    assert region.centre.tolist() == [1, 2, 0]
    with pytest.raises(DataError, match="rectangle"):
        GroundRegion(frame=torch.eye(3, dtype=D), corners=corners.flip(0))


def every_kind(seed: int) -> list[regions.AnyRegion]:
    g = generator(seed)
    box = OrientedBox(
        centre=torch.randn(3, generator=g, dtype=D), rotation=turn(seed),
        half=1 + torch.rand(3, generator=g, dtype=D),
    )  # fmt: skip
    corners = torch.tensor([[0.0, 0.0], [2.0, 4.0]], dtype=D)
    voxel = voxels(seed, (4, 3, 5), 0.4)
    foreground = partition_grid.central_box(scene(seed)[0])
    return [
        OrientedRegion(box=box),
        OrientedRegion(box=box, bounds=replace(box, half=2 * box.half)),
        GroundRegion(frame=turn(seed), corners=corners),
        GroundRegion(frame=turn(seed), corners=corners, bounds=corners * 2),
        voxel,
        replace(voxel, bounds=torch.stack([voxel.low, voxel.low + 1])),
        *blocks.contracted_regions(foreground, (2, 1, 1), turn(seed)),
    ]


@settings(max_examples=5)
@given(seed=SEEDS)
def test_saved_regions_come_back(seed, tmp_path_factory):
    path = tmp_path_factory.mktemp("regions") / "regions.safetensors"
    made = every_kind(seed)
    regions.save_regions(path, made)
    points = 3 * torch.randn(100, 3, generator=generator(seed), dtype=D)
    back = regions.load_regions(path)
    assert len(back) == len(made)
    for mine, other in zip(made, back, strict=True):
        assert isinstance(other, Region)
        assert type(mine) is type(other)
        assert torch.equal(mine.distance(points), other.distance(points))
        assert torch.equal(mine.centre, other.centre)


def test_foreign_newer_and_damaged_files_are_refused(tmp_path):
    path = tmp_path / "regions.safetensors"
    with pytest.raises(DataError, match="no such file"):
        regions.load_regions(path)
    facts = {"format": regions.KIND, "version": 1, "regions": [{"kind": "OrientedRegion"}]}
    for change in (
        {"format": "other"}, {"version": 3}, {}, {"regions": [{"kind": "Sphere"}]}, {"regions": 3},
        {"regions": [3]},
    ):  # fmt: skip
        write_tensors(path, {}, facts | change)
        with pytest.raises(DataError, match="regions.safetensors"):
            regions.load_regions(path)


def as_before(path: Path) -> None:
    """Write a file of regions as version 1 did: voxels as they are."""
    tensors, facts = read_tensors(path)
    for i, entry in enumerate(facts["regions"]):
        for name, shape in entry.pop("deflated").items():
            voxels = inflated(tensors[f"{i}.{name}"], math.prod(shape))
            tensors[f"{i}.{name}"] = voxels.reshape(shape).bool()
    write_tensors(path, tensors, facts | {"version": 1})


def test_files_of_the_first_version_are_read(tmp_path):
    path = tmp_path / "regions.safetensors"
    made = voxels(3, (5, 6, 7), 0.5)
    regions.save_regions(path, [made])
    as_before(path)
    (back,) = regions.load_regions(path)
    assert isinstance(back, VoxelRegion)
    assert torch.equal(back.cells, made.cells)


def test_voxels_take_no_more_than_they_tell(tmp_path):
    path = tmp_path / "regions.safetensors"
    full = torch.ones(64, 64, 16, dtype=torch.bool)
    region = VoxelRegion(
        frame=torch.eye(3, dtype=D), low=torch.zeros(3, dtype=D), side=1.0, cells=full
    )
    regions.save_regions(path, [region])
    assert path.stat().st_size < 2000


@pytest.mark.parametrize(
    "shapes",
    [3, "cells", {"cells": 3}, {"cells": [2, 2]}, {"cells": [-1, -8]}, {"cells": [None]}, {},
     {"cells": [float("inf")]}, {"cells": [10**15]}],
    ids=str,
)  # fmt: skip
def test_shapes_that_no_voxels_have(tmp_path, shapes):
    path = tmp_path / "regions.safetensors"
    cells = torch.ones(2, 2, 2, dtype=torch.bool)
    region = VoxelRegion(
        frame=torch.eye(3, dtype=D), low=torch.zeros(3, dtype=D), side=1.0, cells=cells
    )
    regions.save_regions(path, [region])
    tensors, facts = read_tensors(path)
    facts["regions"][0]["deflated"] = shapes
    write_tensors(path, tensors, facts)
    with pytest.raises(DataError, match="regions.safetensors: damaged") as caught:
        regions.load_regions(path)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_million_distances_take_seconds():
    cells = torch.from_numpy(np.random.default_rng(0).random((64, 64, 24)) < 0.5)
    region = VoxelRegion(
        frame=torch.eye(3, dtype=D), low=torch.zeros(3, dtype=D), side=1.0, cells=cells
    )
    points = torch.rand(10**6, 3, generator=generator(0), dtype=D) * 80 - 8
    start = time.perf_counter()
    region.distance(points)
    assert time.perf_counter() - start < 20
