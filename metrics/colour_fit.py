"""Fit a render's colours to the truth: extra columns, never the main one, since it sees the truth."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import UsageError

ROUNDS = 5
"""How often the fit is repeated on its own result (mip-NeRF 360's colour correction)."""
CLIPPED = 0.5 / 255
"""Values within this of 0 or 1 may have been clipped and take no part in the fit."""


def fit_colours(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "h w 3"],
    mask: Bool[Tensor, "h w"] | None,
    kind: str,
) -> Float[Tensor, "h w 3"]:
    """The image after least-squares maps features(image) -> target, clipped, ROUNDS times.

    A channel without any usable pixel is left alone; a rank-deficient fit takes the solution of
    least norm. Pixels take part in a channel's fit where that channel is unclipped in the current
    image, in the image as it came and in the target.

    Args:
        image: The render, in [0, 1].
        target: The truth, in [0, 1].
        mask: True where a pixel takes part in the fit; the map is applied everywhere.
        kind: "cc_affine" (the channels and 1) or "cc_quadratic" (and their 6 products).
    Returns: In [0, 1], float32, not rounded to 8 bit.
    Raises: UsageError on another kind.
    Source: Barron et al. 2022, mip-NeRF 360's evaluation code, as later releases use it.
    """
    if kind not in ("cc_affine", "cc_quadratic"):
        raise UsageError(f"no colour fit {kind!r}; known: cc_affine, cc_quadratic")
    start, truth = image.double().reshape(-1, 3), target.double().reshape(-1, 3)
    usable = _unclipped(start) & _unclipped(truth)
    if mask is not None:
        usable &= mask.reshape(-1, 1)
    now = start
    for _ in range(ROUNDS):
        features = _features(now, kind)
        used = usable & _unclipped(now)
        columns = []
        for channel in range(3):
            rows = used[:, channel]
            if rows.any():
                solution = torch.linalg.lstsq(
                    features[rows], truth[rows, channel, None], driver="gelsd"
                )
                columns.append(features @ solution.solution[:, 0])
            else:
                columns.append(now[:, channel])
        now = torch.stack(columns, dim=1).clamp(0, 1)
    return now.reshape(image.shape).float()


def _features(colours: Float[Tensor, "n 3"], kind: str) -> Float[Tensor, "n f"]:
    """Columns of the fit: products (quadratic only), channels, 1."""
    ones = torch.ones_like(colours[:, :1])
    if kind == "cc_affine":
        return torch.cat([colours, ones], dim=1)
    first, second = torch.triu_indices(3, 3)
    return torch.cat([colours[:, first] * colours[:, second], colours, ones], dim=1)


def _unclipped(colours: Float[Tensor, "n 3"]) -> Bool[Tensor, "n 3"]:
    return (colours > CLIPPED) & (colours < 1 - CLIPPED)
