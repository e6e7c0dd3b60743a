"""ODBP's cut by what blocks will take to train, not by their load alone."""

from dataclasses import dataclass, replace

import torch

from splatproof.datasets.progress import bar
from splatproof.methods.city.block_work import STEP_COST, Start, block_work, start_of
from splatproof.methods.city.coarse import coarse_roles
from splatproof.methods.city.ground import Ground, ground
from splatproof.methods.city.jobs import Even, block_steps, point_roles, trained_on
from splatproof.methods.city.partition import (
    Partition,
    PartitionSettings,
    odbp_blocks,
    partition,
)
from splatproof.methods.city.point_roles import LEFT_OUT, Auxiliary, Surrounding
from splatproof.reference.partition.block_time import (
    BlockWork,
    block_seconds,
    reweighted,
)
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

ROUNDS = 12
"""Cuts that are tried; the one whose slowest block is fastest stays."""
FINE = 64
"""Weights are whole numbers, of so many for each of the points' loads."""

SAMPLE = 2**15
"""Most Gaussians of a coarse model by which times are predicted. Of one of seneca, 254,518 Gaussians, the twelve cuts
took 90 processor seconds by all of them and 21 by these; predicted times of its blocks differ by at most 4 %."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """How blocks will be trained, as far as their times depend on it."""

    iterations: int
    """Steps of each block, or of a block on average."""
    even: Even = "steps"
    """What all blocks have equally many of."""
    auxiliary: Auxiliary = "none"
    """What takes part beside a block's own points."""
    surrounding: Surrounding = "box"
    """Where ghosts are taken from."""
    thickness: float = 1.0
    """Gaussians in place of each sparse point, or of each of a coarse model's: mean over the training, >= 1."""


def cut(
    scene: Scene,
    blocks: int,
    settings: PartitionSettings,
    training: Training,
    *,
    backend: str = "cpu",
    coarse: Gaussians | None = None,
) -> Partition:
    """Cut a scene into K blocks, as `partition` does; by times where the settings say so.

    ODBP's load is what views see of a block over an epoch. A block's time also goes by what all its steps have
    to move and draw, whoever sees it, and by how many steps it has. So each point's weight starts at its load, and
    after each cut the points of slow blocks become heavier, those of fast ones lighter; of all cuts the one with
    the least predicted time of its slowest block is kept.

    Args:
        scene: With training views, and sparse points with their tracks.
        blocks: Number K of blocks, >= 1.
        settings: Which partition, its thresholds, and what is to be balanced.
        training: What follows the cut.
        backend: Name of the rasterizer for CityGaussian's rule.
        coarse: The coarse model that blocks start from, in the scene's frame; None: they start from points.

    Raises: As `partition` does.

    Source: DPGS, Sec. 3.3, Eqs. 5, 6; times: ours.
    """
    if settings.balance == "load" or blocks == 1:
        return partition(scene, blocks, settings, backend=backend, coarse=coarse)
    place, start = ground(scene, settings.voxel_size), start_of(scene, coarse)
    start = start.sampled(SAMPLE) if start.coarse else start
    weights, tried = place.loads.double(), list[tuple[float, Partition]]()
    with bar(f"cutting {blocks} blocks by their times") as report:
        for done in range(ROUNDS):
            weighed = replace(place, loads=(FINE * weights).round().long())
            found = odbp_blocks(weighed, blocks, "odbp", settings=settings)
            works = expected_works(place, found, training, settings.margin, start)
            seconds = torch.tensor([block_seconds(one, STEP_COST) for one in works]).double()
            tried.append((float(seconds.max()), found))
            weights = reweighted(weights, found.labels, seconds)
            report(done + 1, ROUNDS)
    return min(tried, key=lambda one: one[0])[1]


def expected_works(
    place: Ground,
    found: Partition,
    training: Training,
    margin: float,
    start: Start,
) -> tuple[BlockWork, ...]:
    """What the training of each block will work on.

    Args:
        place: The whole scene.
        found: Its partition.
        training: What follows the cut.
        margin: What a block's region is widened by where it takes its own from a coarse model.
        start: What all blocks start from.
    """
    blocks = range(len(found.views))
    views = [trained_on(place, found, block)[0] for block in blocks]
    steps = block_steps(training.iterations, [int(one.sum()) for one in views], training.even)
    if start.coarse:
        roles = coarse_roles(start.means, place.scene, found, views, training.auxiliary, margin)
    else:
        roles = tuple(
            point_roles(place, found, block, views[block], auxiliary=training.auxiliary,
                        surrounding=training.surrounding)
            for block in blocks
        )  # fmt: skip
    return tuple(
        block_work(
            place.scene, views[block], start, roles[block] != LEFT_OUT, steps=steps[block],
            thickness=training.thickness,
        )
        for block in blocks
    )  # fmt: skip
