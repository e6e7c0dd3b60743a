"""Levels: a factor on each block's colours, so that on average each shows what the photos show."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from splatproof.datasets.progress import bar
from splatproof.methods.contracts.backends import Backend
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.rasterizer.spherical_harmonics import C0, colour, directions_to
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import View

TOGETHER = 8
"""Blocks that are drawn in one pass: their shares and colours fill its 32 channels."""
COVERED = 0.95
"""Opacity from which on a pixel counts: where less is drawn, a photo shows what no block does."""
CLIPPED = 0.5 / 255
"""Values of a photo within this of 0 or 1 may have been clipped and say nothing of a factor."""
TRUST = 1e-4
"""Share of the mean evidence that speaks for a factor of 1: what blocks that are hardly seen go by."""
MOST = 2.0
"""No other light: a factor beyond this, or below its inverse, is held there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Sums over pixels of what each block shows; of two sets of pixels they add up."""

    shown: Float64[Tensor, "3 b b"]
    """For each channel, sum over pixels of block b's share of the pixel times the colour that another adds to it."""
    photos: Float64[Tensor, "3 b"]
    """For each channel, sum over pixels of block b's share times the photo."""

    def __add__(self, other: "Evidence") -> "Evidence":
        """Evidence of both sets of pixels."""
        return Evidence(shown=self.shown + other.shown, photos=self.photos + other.photos)


def evidence(
    shares: Float[Tensor, "h w b"], colours: Float[Tensor, "h w b 3"], photo: Float[Tensor, "h w 3"]
) -> Evidence:
    """What one view says of the blocks' levels.

    Pixels count that blocks cover, channel by channel where the photo is not clipped.

    Args:
        shares: Sum of the weights of each block's Gaussians in each pixel.
        colours: What each block adds to each pixel; over blocks they sum to the image on black.
        photo: In [0, 1].
    """
    weights = torch.where(shares.sum(dim=-1, keepdim=True) >= COVERED, shares, 0).double()
    open_ = ((photo > CLIPPED) & (photo < 1 - CLIPPED)).double()
    return Evidence(
        shown=torch.einsum("hwb,hwc,hwdc->cbd", weights, open_, colours.double()),
        photos=torch.einsum("hwb,hwc,hwc->cb", weights, open_, photo.double()),
    )


def levels(found: Evidence) -> Float64[Tensor, "b 3"]:
    """The factors that solve sum_p w_b (photo - sum_d g_d colours_d) = 0 for every block b and channel.

    Weighted by what a block shows, photo and image are the same on average. Least squares would do that too, were the
    image right but for its levels; of one that is blurred, or noisy, it makes the factors too small.

    Args:
        found: Over all views.

    Returns: Each in [1/2, 2]; 1 for a block that no pixel shows.

    Source: ours.
    """
    count = found.photos.shape[1]
    trust = TRUST * found.shown.diagonal(dim1=1, dim2=2).mean(dim=1)
    trust = torch.where(trust > 0, trust, 1.0)[:, None]
    left = found.shown + trust[:, None] * torch.eye(count, dtype=torch.float64)
    return torch.linalg.solve(left, found.photos + trust).T.clamp(1 / MOST, MOST)


@torch.no_grad()
def block_levels(
    model: Gaussians,
    blocks: Int64[Tensor, " n"],
    count: int,
    views: Sequence[View],
    backend: Backend,
    mode: Mode = "classic",
) -> Float64[Tensor, "b 3"]:
    """The factors on each block's colours that the photos ask for, see `levels`: each view is drawn once.

    Pixels that a view's mask hides do not count.

    Args:
        model: The merged model.
        blocks: Block of each Gaussian, 0 to count - 1.
        count: Number of blocks, at least 1.
        views: Training views.
        backend: Draws them.
        mode: How the model is rasterized.
    """
    zero = torch.zeros(3, count, count, dtype=torch.float64)
    found = Evidence(shown=zero, photos=zero[:, 0])
    there = Gaussians(**{name: value.to(backend.device) for name, value in vars(model).items()})
    blocks = blocks.to(backend.device)
    with bar("levels of blocks") as report:
        for number, view in enumerate(views, start=1):
            shares, colours = _drawn(there, blocks, count, view, backend, mode)
            if view.load_mask is not None:  # no block covers what is hidden
                shares = shares * view.load_mask()[..., None]
            found += evidence(shares, colours, view.load())
            report(number, len(views))
    return levels(found)


def levelled(
    model: Gaussians, blocks: Int64[Tensor, " n"], factors: Float64[Tensor, "b 3"]
) -> Gaussians:
    """The model with each block's colours times its factors, from every side.

    Args:
        model: The merged model.
        blocks: Block of each Gaussian.
        factors: On red, green and blue of each block, > 0.
    """
    each = factors.to(model.sh)[blocks][:, None]
    sh = model.sh * each
    sh[:, :1] += (each - 1) * (0.5 / C0)  # a colour is SH + 0.5
    return replace(model, sh=sh)


def _drawn(
    model: Gaussians,
    blocks: Int64[Tensor, " n"],
    count: int,
    view: View,
    backend: Backend,
    mode: Mode,
) -> tuple[Float[Tensor, "h w b"], Float[Tensor, "h w b 3"]]:
    """Share of each block in each pixel of a view, and what it adds to it."""
    colours = colour(model.sh, directions_to(model.means, view.camera.centre))
    own = torch.cat([torch.ones_like(colours[:, :1]), colours], dim=1)
    parts = []
    for first in range(0, count, TOGETHER):
        some = torch.arange(first, min(first + TOGETHER, count), device=blocks.device)
        told = (blocks[:, None] == some)[..., None] * own[:, None]
        drawn = backend.rasterize(
            view.camera, model.means, model.quaternions, model.scales, model.opacities,
            colours=told.flatten(start_dim=1), mode=mode,
        ).colour  # fmt: skip
        parts.append(drawn.unflatten(-1, (len(some), 4)))
    whole = torch.cat(parts, dim=2).cpu()
    return whole[..., 0], whole[..., 1:]
