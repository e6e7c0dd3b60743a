"""Evidence from several views: which Gaussians lie on pixels that are wrong in all of them."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def marked(
    image: Float[Tensor, "h w 3"],
    truth: Float[Tensor, "h w 3"],
    threshold: float,
    valid: Bool[Tensor, "h w"] | None = None,
) -> Bool[Tensor, "h w"]:
    """Pixels with (e - min e) / (max e - min e) > threshold, e = mean over channels of |I - I*|.

    None where every error is the same. The range is that of pixels that count.

    Args:
        image: Render I.
        truth: Photo I*, in [0, 1].
        threshold: Share of the range, in [0, 1] (FastGS: 0.1).
        valid: Pixels that count; None: all.

    Source: Ren et al. 2025, "FastGS" and its release; no mark where the range is empty: ours.
    """
    error = (image - truth).abs().mean(dim=2)
    counted = torch.ones_like(error, dtype=torch.bool) if valid is None else valid
    if not counted.any():
        return counted
    low, high = error[counted].min(), error[counted].max()
    return (error - low > threshold * (high - low)) & counted & (high > low)


def evidence(weights: Float[Tensor, "p n"], marks: Bool[Tensor, " p"]) -> Float[Tensor, " n"]:
    """Marked pixels that each Gaussian shows on in one view: sum over marked pixels p of w_pi.

    FastGS counts pixels on which a Gaussian is blended at all; here each counts by how much of it is
    the Gaussian's, so that what hardly shows is not blamed, and a backward pass gives the sum.

    Args:
        weights: Compositing weight of each Gaussian at each pixel, in [0, 1].
        marks: Which pixels are marked.

    Source: Ren et al. 2025, "FastGS" and its release; weights in place of counts: ours.
    """
    return weights[marks].sum(dim=0)


def importance(found: Float[Tensor, "v n"]) -> Float[Tensor, " n"]:
    """Mean evidence over the views: what several views agree on is worth growing.

    Args:
        found: Evidence in each of v >= 1 views.

    Source: Ren et al. 2025, "FastGS" and its release (there rounded down).
    """
    return found.mean(dim=0)


def blame(found: Float[Tensor, "v n"], losses: Float[Tensor, " v"]) -> Float[Tensor, " n"]:
    """Evidence weighted by the views' losses, from 0 (least) to 1 (most): (b - min b) / (max b - min b).

    All 0 where all Gaussians have the same b = sum_v L_v e_v.

    Args:
        found: Evidence e_v in each of v >= 1 views.
        losses: Loss L_v of each view, >= 0.

    Source: Ren et al. 2025, "FastGS" and its release; 0 for an empty range: ours.
    """
    total = losses @ found
    if not len(total):
        return total
    span = total.max() - total.min()
    return torch.where(
        span > 0, (total - total.min()) / span.clamp(min=torch.finfo(span.dtype).tiny), 0
    )
