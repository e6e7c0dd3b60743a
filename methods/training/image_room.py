"""How many bytes of photos a training keeps: what a step takes is left free of the same allowance."""

from collections.abc import Iterable
from dataclasses import dataclass

from splatproof.base.memory import MEBIBYTE
from splatproof.methods.contracts.run import Run
from splatproof.reference.types.scene import View

STEP_BYTES = 96
"""Bytes a pixel that a step takes: photo, render, gradients and loss, and a photo while it is decoded. 87
were measured at 4000 x 3000 with no photo kept."""
READING_BYTES = 68
"""Bytes a pixel that reading a photo takes beside a step: decoded, undistorted, made smaller. 67 were measured
of a photo of brighton_beach, whose lens bends most."""
LEAST_SHARE = 4
"""A quarter of the allowance is for photos, however large they are."""

FREE_SHARE = 0.3
"""Share of the memory that is free that a fit may take for photos."""


def image_allowance(free: float) -> int:
    """Bytes for photos of a fit that somebody asks for by itself: a share of what is free, and no less than any run has.

    Suites do not ask: what they measure must not change with what else a machine does. No number of a model depends on it but those
    of method `auto`, whose plan goes by the machine's speed anyway, unless the number of steps is given.

    Args:
        free: Megabytes of this machine's memory that are free.
    """
    return max(Run.image_bytes, int(FREE_SHARE * free * MEBIBYTE))


@dataclass(frozen=True, kw_only=True)
class ImageRoom:
    """How photos share memory with a step."""

    kept: int
    """Bytes of photos that are kept."""
    ahead: bool
    """Whether the next photo may be read while a step is computed."""


def image_room(allowed: int, views: Iterable[View]) -> ImageRoom:
    """The allowance less what a step on the largest view takes, and less what reading the next photo takes.

    Args:
        allowed: Bytes for photos and a step, as `Run.image_bytes` says.
        views: What is trained on.

    Returns: Where less than a quarter of the allowance would be left for photos, none is read ahead; where even a
        step leaves less, a quarter it is.

    Source: ours.
    """
    largest = max((view.camera.width * view.camera.height for view in views), default=0)
    least = allowed // LEAST_SHARE
    kept = allowed - (STEP_BYTES + READING_BYTES) * largest
    if allowed and kept >= least:
        return ImageRoom(kept=kept, ahead=True)
    return ImageRoom(kept=max(least, allowed - STEP_BYTES * largest), ahead=False)
