"""What one block of a city was, and what it cost."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class BlockFacts:
    """What one block was, and what it cost."""

    block: int
    views: int
    """Training views."""
    points: int
    """Sparse points that it owns."""
    load: int
    """Summed track length of the points it owns."""
    seconds: float = 0.0
    """Wall seconds of its training."""
    peak_mb: float = 0.0
    """Peak resident memory of the process that trained it, in 2^20 bytes."""
    primitives: int = 0
    """Gaussians when its training ended, ghosts left out."""
    kept: int = 0
    """Of those, what the merged model has."""
    note: str = ""
    """What was out of the ordinary; empty if nothing was."""
