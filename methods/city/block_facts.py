"""What one block of a city was, and what it cost."""

import json
from dataclasses import asdict, dataclass
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
    """Peak resident memory of the process that trained it, in 2^20 bytes."""
    refine_seconds: float = 0.0
    """Wall seconds of the refinement of its part; 0: none was refined apart."""
    refine_cpu_seconds: float = 0.0
    """Processor seconds of that, over all threads."""
    primitives: int = 0
    """Number of Gaussians when its training ended, ghosts left out."""
    densifications: int = -1
    """How often training densified the block; -1: not known."""
    kept: int = 0
    """Number of these Gaussians that the merge kept."""
    note: str = ""
    """What was out of the ordinary; empty if nothing was."""

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
