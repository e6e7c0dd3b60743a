"""Partitions of a scene side by side: how even the loads, how long the cuts, how many views a block."""

from collections.abc import Iterator
from typing import Any

import torch

from splatproof.base.errors import UsageError
from splatproof.methods.city.ground import Ground, ground
from splatproof.methods.city.partition import (
    Partition,
    PartitionSettings,
    blockgaussian_blocks,
    citygaussian_blocks,
    edge_cut,
    odbp_blocks,
    vastgaussian_blocks,
)
from splatproof.reference.types.scene import Scene

PAPER = PartitionSettings(imbalance=0.05, seeds=1)
"""DPGS' own bound, with one METIS seed."""


def partitions(place: Ground, blocks: int, backend: str = "cpu") -> Iterator[Partition]:
    """All partitions of a scene into K blocks, one after the other.

    "odbp" asks for loads within 1 % of the mean and takes the best of ten METIS seeds; "odbp_paper"
    is DPGS' own setting, 5 %, with one seed.

    Args:
        place: The scene's points and views on the ground plane.
        blocks: Number of blocks K.
        backend: Name of the rasterizer for CityGaussian's view rule.
    """
    yield odbp_blocks(place, blocks, "odbp", settings=PartitionSettings())
    yield odbp_blocks(place, blocks, "odbp_paper", settings=PAPER)
    yield blockgaussian_blocks(place, blocks, PartitionSettings(method="blockgaussian"))
    yield vastgaussian_blocks(place, blocks)
    yield citygaussian_blocks(place, blocks, backend)


def partition_row(place: Ground, found: Partition, blocks: int) -> dict[str, Any]:
    """Judge one partition: how even its loads, how long its cut, how many views a block.

    Load is the summed track length of a block's points. Empty blocks count with load 0 and no views.

    Args:
        place: The scene's points and views on the ground plane.
        found: The partition.
        blocks: Number of blocks that were asked for.
    Returns: What `partition_rows` says of one partition.
    """
    load = torch.bincount(found.labels, weights=place.loads.double(), minlength=blocks)
    mean = load.mean()
    views = torch.tensor([int(chosen.sum()) for chosen in found.views]).double()
    return {
        "scene": place.scene.name,
        "k": blocks,
        "method": found.method,
        "load_std_over_mean": float(load.std(correction=0) / mean) if mean > 0 else 0.0,
        "load_max_over_mean": float(load.max() / mean) if mean > 0 else 0.0,
        "edge_cut": edge_cut(place, found.labels, blocks),
        "views_mean": float(views.mean()),
        "views_max": int(views.max()),
        "note": found.note,
    }


def partition_rows(
    scene: Scene, ks: tuple[int, ...], *, voxel_size: float | None = None, backend: str = "cpu"
) -> list[dict[str, Any]]:
    """Compare the partitions of a scene: a row for each number of blocks and method.

    Args:
        scene: Scene with training views, and sparse points with tracks.
        ks: Numbers of blocks to compare, each at least 1.
        voxel_size: Side of ODBP's voxels in scene units; None: 64 along the scene.
        backend: Name of the rasterizer for CityGaussian's view rule.

    Returns: Rows with scene, k, method, load_std_over_mean, load_max_over_mean, edge_cut,
        views_mean, views_max and note.

    Raises: UsageError for a number of blocks below 1; DataError for more blocks than the scene has
        cameras or distinct points, or for a scene without training views or points.
    """
    if any(k < 1 for k in ks):
        raise UsageError(f"numbers of blocks {ks}: expected each at least 1")
    place = ground(scene, voxel_size)
    return [partition_row(place, found, k) for k in ks for found in partitions(place, k, backend)]
