"""How evenly a model's blocks shared the work."""

from collections.abc import Sequence

import numpy as np

from splatproof.methods.city.block_facts import BlockFacts
from splatproof.metrics.balance import spread

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
