"""The comparison of partitions: its figures by hand, its rows on a small scene, ODBP on a real one."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import torch

from helpers.city_scene import small_scene
from helpers.real_scenes import real_scene
from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError, UsageError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.city import citygaussian_views as rule
from splatproof.methods.city.ground import ground
from splatproof.methods.city.partition import Partition, PartitionSettings, near_square
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene
from splatproof.suites import partition
from splatproof.suites.gallery import blocks as pictures

COLUMNS = {
    "scene", "k", "method", "load_std_over_mean", "load_max_over_mean", "edge_cut", "views_mean",
    "views_max", "note",
}  # fmt: skip
METHODS = ["odbp", "odbp_paper", "blockgaussian", "vastgaussian", "citygaussian"]


def test_a_row_by_hand():
    scene = small_scene(60)
    place = ground(scene, voxel_size=100.0)  # one voxel: nothing to cut
    labels = (torch.arange(60) >= 20).long()
    a, b = (int(place.loads[labels == k].sum()) for k in (0, 1))
    views = (place.trained, torch.zeros_like(place.trained))
    row = partition.partition_row(place, Partition(method="m", labels=labels, views=views), 2)
    mean = (a + b) / 2
    assert row["load_max_over_mean"] == pytest.approx(max(a, b) / mean)
    assert row["load_std_over_mean"] == pytest.approx(abs(a - b) / 2 / mean)
    assert (row["edge_cut"], row["views_mean"], row["views_max"]) == (0, 4.0, 8)


def test_the_cut_counts_neighbouring_voxels_of_different_blocks():
    scene = small_scene()
    place = ground(scene, voxel_size=0.5)
    side = (place.positions[:, 0] > place.positions[:, 0].min() + 1.0).long()  # a voxel wall
    views = (place.trained, place.trained)
    row = partition.partition_row(place, Partition(method="m", labels=side, views=views), 2)
    cells = ((place.positions - place.positions.min(dim=0).values) / 0.5).long()
    occupied = {tuple(cell) for cell in cells.tolist()}
    across = sum((2, y, z) in occupied for x, y, z in occupied if x == 1)
    assert row["edge_cut"] == across > 0


@pytest.mark.parametrize("k", [1, 4])
def test_every_method_gives_a_row(k):
    rows = partition.partition_rows(small_scene(), (k,), voxel_size=0.25)
    assert [row["method"] for row in rows] == METHODS
    for row in rows:
        assert set(row) == COLUMNS
        assert row["k"] == k
        assert 1 <= row["load_max_over_mean"] <= k + 1e-9
        assert 0 <= row["views_mean"] <= row["views_max"] <= 8
        if k == 1:
            assert row["load_std_over_mean"] == row["edge_cut"] == 0
    if k == 4:
        assert rows[0]["load_std_over_mean"] <= 0.01
        assert all(rows[0]["load_std_over_mean"] < row["load_std_over_mean"] for row in rows[2:])


def test_test_views_belong_to_no_block():
    place = ground(small_scene(), voxel_size=0.25)
    for found in partition.partitions(place, 2):
        for chosen in found.views:
            assert not chosen[list(place.scene.test)].any()


def test_loads_that_cannot_be_balanced_are_noted():
    scene = small_scene(30)
    together = scene.points.positions.clone()
    together[:25] = together[0]
    scene = replace(scene, points=replace(scene.points, positions=together))
    rows = partition.partition_rows(scene, (4,), voxel_size=0.25)
    assert "could not be met" in str(rows[0]["note"])


@pytest.mark.parametrize(
    ("k", "shape"), [(1, (1, 1)), (4, (2, 2)), (8, (4, 2)), (7, (7, 1)), (12, (4, 3))]
)
def test_near_squares(k, shape):
    assert near_square(k) == shape


def test_wrong_numbers_of_blocks_are_refused():
    with pytest.raises(UsageError):
        partition.partition_rows(small_scene(30), (0,))
    with pytest.raises(DataError):
        partition.partition_rows(small_scene(30), (64,))


def test_narrowed_cameras_see_the_same():
    scene = small_scene(30)
    camera = scene.views[0].camera
    small = rule.narrowed(camera, 12)
    assert (small.width, small.height) == (12, 9)
    pixel, _ = project_points(camera, scene.points.positions)
    half, _ = project_points(small, scene.points.positions)
    torch.testing.assert_close(half, pixel / 2)
    assert rule.narrowed(camera, 24) is camera


@pytest.mark.real
@pytest.mark.parametrize("k", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_odbp_balances_seneca_to_one_percent(k):
    """Std / mean at most 1 %, for at most 15 % more cut than as many METIS runs at 5 %."""
    scene = open_scene(real_scene("seneca"), Protocol(name="p", source="ours"))
    place = ground(scene)
    ours, paper = (
        partition.partition_row(place, found, k)
        for found in (
            partition.odbp_blocks(place, k, "odbp", settings=PartitionSettings()),
            partition.odbp_blocks(
                place, k, "odbp_paper", settings=PartitionSettings(imbalance=0.05)
            ),
        )
    )
    assert ours["load_std_over_mean"] <= 0.01
    assert ours["edge_cut"] <= 1.15 * paper["edge_cut"]
    assert not ours["note"]
    others = [
        partition.blockgaussian_blocks(place, k, PartitionSettings()),
        partition.vastgaussian_blocks(place, k),
    ]
    for found in others:
        assert partition.partition_row(place, found, k)["load_std_over_mean"] > 0.1


def draw_random_spectrum(scene: Scene, path: Path) -> None:
    del scene
    pictures.draw_spectrum(random_gaussians(200, degree=3), path, gate=0.2)


@pytest.mark.parametrize(
    "draw",
    [
        pictures.draw_partitions,
        pictures.draw_stitching,
        pictures.draw_sampling,
        draw_random_spectrum,
    ],
)
def test_pictures_are_drawn(draw: Callable[[Scene, Path], None], tmp_path: Path):
    draw(small_scene(), tmp_path / "a.png")
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image is not None
    assert image.std() > 5
    assert list(tmp_path.iterdir()) == [tmp_path / "a.png"]
