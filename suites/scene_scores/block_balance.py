"""How evenly a model's blocks shared the work."""

from collections.abc import Mapping, Sequence

import numpy as np

from splatproof.methods.city.block_facts import BlockFacts
from splatproof.metrics.balance import makespan, spread

MACHINES = 4
"""How many machines train the blocks whose wall time is simulated."""

FIELDS = {
    "load": "load",
    "views": "views",
    "points": "points",
    "primitives": "primitives",
    "seconds": "seconds",
    "cpu": "cpu_seconds",
    "memory": "peak_mb",
}
"""Name in metrics: field of BlockFacts."""


def fewest_densifications(blocks: Sequence[BlockFacts]) -> dict[str, float]:
    """block_densifications: how often the block was densified that was so least; nothing if not known.

    Args:
        blocks: One a block; those that were left empty do not count.
    """
    known = [b.densifications for b in blocks if b.primitives and b.densifications >= 0]
    return {"block_densifications": float(min(known))} if known else {}


def retention(blocks: Sequence[BlockFacts]) -> dict[str, float]:
    """retention: share of all blocks' trained Gaussians that the merge kept; nothing if none was trained.

    What is trained and thrown away is work lost to the overlap of the blocks' regions.

    Args:
        blocks: One a block, after the merge; ghosts are not among their Gaussians.
    """
    trained = sum(block.primitives for block in blocks)
    return {"retention": sum(block.kept for block in blocks) / trained} if trained else {}


def four_machine_seconds(
    stages: Mapping[str, float], blocks: Sequence[BlockFacts]
) -> dict[str, float]:
    """four_machine_seconds: wall seconds of the whole if MACHINES machines had trained the blocks, those
    first that take longest, and one of them did all else; nothing if a block's seconds are not known.

    What is sent between machines is not counted. Seconds are those that were measured, so other work on the
    machine, blocks trained at the same time among it, counts as if it were everywhere.

    Args:
        stages: Measured wall seconds of each stage, "blocks" among them.
        blocks: One a block.
    Source: list scheduling by longest first, Graham 1969; `metrics.balance.makespan`.
    """
    if "blocks" not in stages or not all(block.seconds for block in blocks):
        return {}
    alone = sum(seconds for name, seconds in stages.items() if name != "blocks")
    longest_first = sorted((block.seconds for block in blocks), reverse=True)
    return {"four_machine_seconds": alone + makespan(longest_first, MACHINES)}


def balance_metrics(blocks: Sequence[BlockFacts]) -> dict[str, float]:
    """<what>_std_over_mean and <what>_max_over_mean over blocks, for all that FIELDS names.

    Args:
        blocks: One a block; what is 0 in all of them (never measured) is left out.
    """
    found = {}
    for name, field in FIELDS.items():
        values = np.array([getattr(block, field) for block in blocks], dtype=float)
        if values.any():
            std, most = spread(values)
            found |= {f"{name}_std_over_mean": std, f"{name}_max_over_mean": most}
    return found
