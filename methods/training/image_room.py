"""How many bytes of photos a training keeps: what a step takes is left free of the same allowance."""

from collections.abc import Iterable

from splatproof.reference.types.scene import View

STEP_BYTES = 96
"""Bytes a pixel that a step takes: photo, render, gradients and loss, and a photo while it is decoded. 87
were measured at 4000 x 3000 with no photo kept."""
LEAST_SHARE = 4
"""A quarter of the allowance is for photos, however large they are."""


def image_room(allowed: int, views: Iterable[View]) -> int:
    """Bytes of photos that are kept: the allowance less what a step on the largest view takes.

    Args:
        allowed: Bytes for photos and a step, as `Run.image_bytes` says.
        views: What is trained on.

    Source: ours.
    """
    largest = max((view.camera.width * view.camera.height for view in views), default=0)
    return max(allowed // LEAST_SHARE, allowed - STEP_BYTES * largest)
