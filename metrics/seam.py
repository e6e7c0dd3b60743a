"""Seam-aware metrics as the StitchGS paper defines them (the release computes others: seam_released).

The paper's sums run over the seam pixels of all test images together, so a view gives sums and
`seam_scores` divides them once.
"""

import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass, field

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.base.errors import DataError, UsageError
from splatproof.metrics.pairs import check_pair
from splatproof.metrics.pixel import psnr_of_mse

INNER, OUTER = 1.0, 1.1
"""The overlap band: normalised distances to a primitive's own box in (INNER, OUTER]."""
TOP = 2
"""How many of a pixel's strongest contributors are looked at (k in the paper)."""
EPSILON = 1e-6
"""Added to the mean depth gradient, in scene units a pixel."""
ON_SEAM: tuple[str, ...] = ("seam_psnr", "seam_psnr_sum", "bpd_l1", "bpd_l1_sum", "nbgj")
"""Metrics that are undefined without a seam pixel."""


@dataclass(frozen=True, kw_only=True)
class SeamScores:
    """Values by name; nan where undefined, and then `undefined` says why."""

    values: dict[str, float]
    undefined: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamView:
    """One test view of a model whose primitives belong to blocks."""

    image: Float[Tensor, "h w 3"]
    """Render of the whole model, in [0, 1]."""
    truth: Float[Tensor, "h w 3"]
    """What the camera saw, in [0, 1]."""
    depth: Float[Tensor, "h w"]
    """Depth of the whole model in scene units."""
    seam: Bool[Tensor, "h w"]
    """The seam mask, see `seam_mask`."""
    block_weights: Float[Tensor, "h w b"]
    """Compositing weight that each block's primitives have in the whole model's render."""
    block_images: Float[Tensor, "b h w 3"]
    """Render of each block alone, in [0, 1]."""
    block_depths: Float[Tensor, "b h w"]
    """Depth of each block alone in scene units."""


@dataclass(frozen=True, kw_only=True)
class SeamSums:
    """Sums over the seam pixels of some views."""

    pixels: int = 0
    """Number of all pixels, seam or not."""
    seam_pixels: int = 0
    squared_error: float = 0.0
    """Sum of ||I - I^||_2^2 between truth and render, the channels summed."""
    block_difference: float = 0.0
    """Sum of |I_a - I_b|_1 between the two leading blocks alone, the channels summed."""
    jump: float = 0.0
    """Sum of |grad D_a - grad D_b|_1 between these two blocks, in scene units a pixel."""
    gradient: float = 0.0
    """Sum of |grad D|_1 of the whole model's depth, in scene units a pixel."""

    def __add__(self, other: "SeamSums") -> "SeamSums":
        """Sums over the views of both."""
        return SeamSums(
            **{
                name: mine + theirs
                for name, mine, theirs in zip(
                    self.__dataclass_fields__, astuple(self), astuple(other), strict=True
                )
            }
        )


def overlap_band(distances: Float[Tensor, " n"]) -> Bool[Tensor, " n"]:
    """Which primitives lie in the overlap band: 1.0 < d <= 1.1.

    Args:
        distances: Normalised distance of each primitive to the oriented box of its own block.
    Source: StitchGS, Sec. 5.1.
    """
    return (distances > INNER) & (distances <= OUTER)


def seam_mask(
    contributor_ids: Int[Tensor, "h w k"], band: Bool[Tensor, " n"], blocks: Int[Tensor, " n"]
) -> Bool[Tensor, "h w"]:
    """Pixels of which any of the two contributors of largest weight is in the overlap band.

    A model of a single block has no seam, whatever lies in its rim: the mask is empty then.

    Args:
        contributor_ids: Primitives of largest compositing weight, largest first; -1: none.
        band: Which primitives are in the overlap band.
        blocks: Block of each primitive.
    Raises: UsageError if fewer than two contributors a pixel were kept.
    Source: StitchGS, Sec. 5.1, k = 2; the single block is ours.
    """
    if contributor_ids.shape[2] < TOP:
        raise UsageError(
            f"{contributor_ids.shape[2]} contributors a pixel, the seam mask needs {TOP}; "
            f"render with contributors={TOP}"
        )
    if len(blocks.unique()) < 2:
        return torch.zeros(contributor_ids.shape[:2], dtype=torch.bool)
    strongest = contributor_ids[..., :TOP]
    return (band[strongest.clamp(min=0)] & (strongest >= 0)).any(dim=2)


def leading_blocks(block_weights: Float[Tensor, "h w b"]) -> Int[Tensor, "h w 2"]:
    """The blocks a and b of largest weight at each pixel, a first, ties by the lower number.

    Where only one block (or none) is seen there is no second one: b = a, so that the pixel adds
    nothing to the differences between blocks but stays among the seam pixels they are divided by.
    """
    values, blocks = torch.sort(block_weights, dim=2, descending=True, stable=True)
    if blocks.shape[2] == 1:
        return blocks.expand(-1, -1, 2)
    second = torch.where(values[..., 1] > 0, blocks[..., 1], blocks[..., 0])
    return torch.stack([blocks[..., 0], second], dim=2)


def depth_gradient(depth: Float[Tensor, "b h w"]) -> Float[Tensor, "b h w 2"]:
    """(dD/dx, dD/dy) by finite differences: central inside, one-sided at borders, 0 across 1 pixel."""
    parts = [
        torch.gradient(depth, dim=axis)[0] if depth.shape[axis] > 1 else torch.zeros_like(depth)
        for axis in (2, 1)
    ]
    return torch.stack(parts, dim=3)


def seam_sums(view: SeamView) -> SeamSums:
    """What one view adds to the sums.

    Raises: DataError where images are not in [0, 1] on the seam, or a depth is not finite.
    """
    colours, depths = view.block_images.double(), view.block_depths.double()
    depth = view.depth.double()
    for what, values in (("depth", depth), ("block depths", depths)):
        if not bool(values.isfinite().all()):
            raise DataError(f"seam metrics: {what} holds values that are not finite")
    whole = check_pair(view.image, view.truth, view.seam, metric="seam_psnr")
    error = torch.from_numpy((whole.image - whole.target) ** 2).sum()  # zero off the seam
    first, second = leading_blocks(view.block_weights).unbind(dim=2)
    of_a, of_b = _at(colours, first), _at(colours, second)
    blocks = check_pair(of_a, of_b, view.seam, metric="bpd_l1")
    slopes = depth_gradient(depths)
    jump = (_at(slopes, first) - _at(slopes, second)).abs().sum(dim=2)
    return SeamSums(
        pixels=view.seam.numel(),
        seam_pixels=int(view.seam.sum()),
        squared_error=float(error),
        block_difference=float(abs(blocks.image - blocks.target).sum()),
        jump=float(jump[view.seam].sum()),
        gradient=float(depth_gradient(depth[None])[0].abs().sum(dim=2)[view.seam].sum()),
    )


def seam_scores(views: Iterable[SeamSums]) -> SeamScores:
    """The paper's four metrics over some views, the ambiguous ones in both readings.

    seam_psnr and bpd_l1 are means over pixels and channels; seam_psnr_sum and bpd_l1_sum sum the
    channels of a pixel, as the paper's norms read literally (4.77 dB lower, three times higher).
    nbgj = mean |grad D_a - grad D_b|_1 / (mean |grad D|_1 + 1e-6), and seam_coverage is the share
    of seam pixels among all.

    Args:
        views: Sums of each view; read once.
    Returns: Without a seam pixel all but the coverage are nan, and without a pixel that too.
    Source: StitchGS, Sec. 5.1.
    """
    total = sum(views, SeamSums())
    count = total.seam_pixels
    coverage = count / total.pixels if total.pixels else math.nan
    if count == 0:
        why = f"the seam mask is empty in all {total.pixels} pixels"
        undefined = dict.fromkeys(ON_SEAM, why)
        if total.pixels == 0:
            undefined["seam_coverage"] = "no view was given"
        nothing = dict.fromkeys(ON_SEAM, math.nan) | {"seam_coverage": coverage}
        return SeamScores(values=nothing, undefined=undefined)
    values = (
        psnr_of_mse(total.squared_error / count / 3),
        psnr_of_mse(total.squared_error / count),
        total.block_difference / count / 3,
        total.block_difference / count,
        (total.jump / count) / (total.gradient / count + EPSILON),
    )
    return SeamScores(values=dict(zip(ON_SEAM, values, strict=True)) | {"seam_coverage": coverage})


def _at(values: Float[Tensor, "b h w c"], blocks: Int[Tensor, "h w"]) -> Float[Tensor, "h w c"]:
    """At each pixel the values of the block that is named there."""
    rows, columns = torch.meshgrid(*map(torch.arange, blocks.shape), indexing="ij")
    return values[blocks, rows, columns]
