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


def over_hard_cut(blocks: Sequence[BlockFacts]) -> dict[str, float]:
    """over_hard_cut: Gaussians that the merge kept over those that a hard cut of the same blocks keeps.

    What a merge adds to storage: 1.2 is a fifth more. Nothing for a single block, or if cores were not counted.

    Args:
        blocks: One a block, after the merge.
    """
    cores = [block.core for block in blocks]
    if len(blocks) < 2 or min(cores) < 0 or not sum(cores):
        return {}
    return {"over_hard_cut": sum(block.kept for block in blocks) / sum(cores)}


def four_machine_seconds(
    stages: Mapping[str, float],
    cpu: Mapping[str, float],
    blocks: Sequence[BlockFacts],
    alone: Mapping[str, float],
) -> dict[str, float]:
    """What the whole would take if MACHINES machines had trained the blocks, and refined the parts where the
    refinement has parts, those first that take longest, and one of them did all else.

    four_machine_seconds are wall seconds, in which other work on the machine, blocks trained at the same time among
    it, counts as if it were everywhere; four_machine_cpu_seconds are processor seconds, wall seconds of machines of
    one core with nothing else to do. What is sent between machines is not counted. Either is left out where it is not
    known of a block, a stage, or what a refinement in parts does beside them; a block that was left empty takes nothing.

    Args:
        stages: Measured wall seconds of each stage, "blocks" among them.
        cpu: Processor seconds of each stage.
        blocks: One a block.
        alone: What a refinement in parts takes without its parts, "seconds" and "cpu_seconds"; empty: not known.
    Source: list scheduling by longest first, Graham 1969; `metrics.balance.makespan`.
    """
    there = [block for block in blocks if block.primitives or block.seconds]
    wall = _longest_path(
        stages, [b.seconds for b in there], [b.refine_seconds for b in there], alone.get("seconds")
    )
    busy = _longest_path(
        cpu, [b.cpu_seconds for b in there], [b.refine_cpu_seconds for b in there],
        alone.get("cpu_seconds"),
    )  # fmt: skip
    named = {"four_machine_seconds": wall, "four_machine_cpu_seconds": busy}
    return {name: seconds for name, seconds in named.items() if seconds is not None}


def _longest_path(
    stages: Mapping[str, float],
    trained: Sequence[float],
    refined: Sequence[float],
    beside: float | None,
) -> float | None:
    """Seconds of all stages, of which blocks and refined parts are shared out; None where they are not known."""
    if "blocks" not in stages or not trained or not all(trained):
        return None
    shared = [trained]
    alone = sum(seconds for name, seconds in stages.items() if name != "blocks")
    if any(refined):
        if beside is None:
            return None
        shared.append(refined)
        alone += beside - stages["refine"]
    return alone + sum(makespan(sorted(each, reverse=True), MACHINES) for each in shared)


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
