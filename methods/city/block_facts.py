"""What one block of a city was, and what it cost."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from splatproof.base.files import read_text, write_text
from splatproof.reference.partition.block_time import BlockWork


@dataclass(frozen=True, kw_only=True)
class BlockFacts:
    """What one block was, and what it cost."""

    block: int
    """Number of the block, from 0."""
    views: int
    """Number of its training views."""
    points: int
    """Number of sparse points that it owns."""
    load: int
    """Sum of the track lengths of these points: how often views see them."""
    steps: int = 0
    """Number of its training steps; 0: not known."""
    pixels: float = 0.0
    """Mean number of pixels of its training views; 0: not known."""
    pairs: float = 0.0
    """Mean number of pairs of Gaussian and tile in one of its views, as expected of what it starts with, see
    `reference.partition.block_time.pairs_a_view`; 0: not known."""
    gaussians: float = 0.0
    """Mean of the numbers of Gaussians, ghosts included, that its training started and ended with; before
    it has, what it starts with. 0: not known."""
    seconds: float = 0.0
    """Wall seconds of its training."""
    cpu_seconds: float = 0.0
    """Processor seconds of its training, over all threads: what other work on the machine changes least."""
    peak_mb: float = 0.0
    """Peak resident memory of the process that trained it, while it did, in 2^20 bytes."""
    refine_seconds: float = 0.0
    """Wall seconds of the refinement of its part; 0: none was refined apart."""
    refine_cpu_seconds: float = 0.0
    """Processor seconds of that, over all threads."""
    primitives: int = 0
    """Number of Gaussians when its training ended, ghosts left out."""
    densifications: int = -1
    """How often training densified the block; -1: not known."""
    least_visits: int = -1
    """How often training visits the one of its photos that it visits least; -1: not known."""
    kept: int = 0
    """Number of these Gaussians that the merge kept."""
    core: int = -1
    """Number of these Gaussians that lie in the block, d <= 1, which is what a hard cut keeps; -1: not known."""
    note: str = ""
    """What was out of the ordinary; empty if nothing was."""
    told: dict[str, str] = field(default_factory=dict)
    """What its training said for the record of the run, such as which weights refined its side views."""

    @property
    def work(self) -> BlockWork:
        """What its time goes by, see `reference.partition.block_time`."""
        return BlockWork(
            steps=float(self.steps), pixels=self.pixels, gaussians=self.gaussians, pairs=self.pairs
        )


def write_facts(path: Path, key: str, facts: BlockFacts) -> None:
    """Say in a file that something was done for a block, and what it cost.

    Args:
        path: The file.
        key: Hash of all that its result depends on.
        facts: The block, with what it cost.
    """
    write_text(path, json.dumps({"key": key, "facts": asdict(facts)}) + "\n")


def read_facts(path: Path, key: str) -> BlockFacts | None:
    """What such a file says; None if there is none, or it is of another key.

    Args:
        path: The file.
        key: Hash of all that the result depends on.
    """
    if not path.exists():
        return None
    stored = json.loads(read_text(path))
    return BlockFacts(**stored["facts"]) if stored["key"] == key else None


def with_parts(blocks: Sequence[BlockFacts], parts: Sequence[BlockFacts]) -> tuple[BlockFacts, ...]:
    """Facts of the blocks with what the refinement of each one's part has cost.

    Args:
        blocks: One a block.
        parts: One for each that was refined apart.
    """
    wall = {part.block: part.seconds for part in parts}
    busy = {part.block: part.cpu_seconds for part in parts}
    return tuple(
        replace(
            one, refine_seconds=wall.get(one.block, 0.0), refine_cpu_seconds=busy.get(one.block, 0.0)
        )
        for one in blocks
    )  # fmt: skip


def least_visited(blocks: Sequence[BlockFacts]) -> int | None:
    """How often training visited the photo that its block visited least; None if that is not known of all.

    Args:
        blocks: One a block; those that were left empty do not count.
    """
    known = [one.least_visits for one in blocks if one.primitives]
    return min(known) if known and min(known) >= 0 else None


def told_by(blocks: Iterable[BlockFacts]) -> dict[str, str]:
    """What the trainings of all blocks said, for one record.

    Args:
        blocks: One a block; an empty one has said nothing.
    Returns: What all said alike, once; of numbers the least and the largest; else each with its blocks.
    """
    said: dict[str, dict[str, list[int]]] = {}
    for one in blocks:
        for name, value in one.told.items():
            said.setdefault(name, {}).setdefault(value, []).append(one.block)
    return {name: _together(values) for name, values in said.items()}


def _together(values: dict[str, list[int]]) -> str:
    """Values, by who said them, as one text."""
    if len(values) == 1:
        return next(iter(values))
    try:
        ordered = sorted(values, key=float)
    except ValueError:
        return "; ".join(f"{value} ({_named(blocks)})" for value, blocks in values.items())
    return f"{ordered[0]} to {ordered[-1]}"


def _named(blocks: list[int]) -> str:
    return f"block{'s' * (len(blocks) > 1)} {', '.join(map(str, blocks))}"
