"""Seam metrics as the StitchGS release has them, of a model whose blocks are boxes."""

from collections.abc import Sequence

import torch

from splatproof.metrics.seam import SeamScores, SeamView
from splatproof.metrics.seam_released import seam_mask_released, seam_view_released
from splatproof.reference.partition.boxes import OrientedBox, Region
from splatproof.reference.types.scene import View


def boxes_of(regions: Sequence[Region]) -> tuple[OrientedBox, ...]:
    """The boxes of a partition's blocks; empty unless every region is one.

    The release's mask lies around boxes, and cells of other shapes have no such number.

    Args:
        regions: Where each block of the partition lies, in the scene's frame.
    """
    found = [
        region if isinstance(region, OrientedBox) else getattr(region, "box", None)
        for region in regions
    ]
    boxes = tuple(box for box in found if isinstance(box, OrientedBox))
    return boxes if len(boxes) == len(found) else ()


def released_scores(
    view: View, seen: SeamView, boxes: Sequence[OrientedBox], *, masked: bool
) -> SeamScores:
    """The released family on one test view, its mask placed by the rendered depth.

    Args:
        view: The test view.
        seen: What was rendered of it; its own seam mask, the partition's, plays no part.
        boxes: Box of each block; a single block has no seam, so all is undefined.
        masked: Whether pixels that the view's mask leaves out do not count.
    Raises: DataError where the render is not in [0, 1] or its depth not finite.
    """
    seam = torch.zeros_like(seen.seam)
    if len(boxes) > 1:
        seam = seam_mask_released(seen.depth, view.camera, boxes)
    mask = view.load_mask() if masked and view.load_mask is not None else None
    return seam_view_released(seen.image, seen.truth, seen.depth, seam, mask)
