"""Depth terms of rendered views: the order of a depth prior, smoothness, and outliers."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.datasets.image_cache import TensorCache
from splatproof.methods.hdgs.settings import DepthSettings
from splatproof.methods.training.prior_pixels import PriorPixels, require_prior
from splatproof.methods.training.terms import Frame, Term
from splatproof.reference.supervision.depth_supervision import edge_weight
from splatproof.reference.supervision.soft_rank import (
    global_depth_loss,
    soft_rank,
    standardised,
)
from splatproof.reference.types.scene import Scene

KEPT_BYTES = 2**28
"""Most bytes of photos' edges that are kept between steps."""
DRAWN = 0.5
"""Alpha from which a pixel shows something whose depth can be ranked."""


def depth_terms(scene: Scene, settings: DepthSettings, unit: float) -> tuple[Term, ...]:
    """The terms that the settings ask for.

    Args:
        scene: What is trained on.
        settings: Weights and sizes.
        unit: Unit of length of the model in scene units: depths are divided by it.

    Raises: DataError if no training view has a depth prior and the global term is on.
    """
    terms: list[Term] = []
    if settings.global_weight:
        require_prior(scene, "depth.global_weight")
        terms.append(order_term(settings))
    return (*terms, *local_terms(settings, unit))


def order_term(settings: DepthSettings) -> Term:
    """1 - rank correlation of rendered disparity and prior, at pixels drawn at random.

    Disparities are compared, not depths: a prior's zero point is unknown, so that its inverse may
    have another order.

    Args:
        settings: Number of pixels, temperature, weight.

    Source: HDGS, Eqs. 9 to 11; on a sample, since the direct form is quadratic in it.
    """
    priors = PriorPixels()

    def loss(frame: Frame) -> Float[Tensor, ""]:
        depth = frame.output.depth
        if (told := priors.of(frame)) is None:
            return depth.new_zeros(())
        prior, valid = told
        counts = valid & (frame.output.alpha.detach() > DRAWN)
        (pixels,) = torch.where(counts.flatten())
        drawn = torch.randperm(len(pixels), generator=frame.moment.generator)
        chosen = pixels[drawn[: settings.pixels].to(pixels)]
        near = frame.view.camera.near
        rendered = 1 / depth.flatten()[chosen].clamp(min=near)
        return global_depth_loss(rendered, prior.flatten()[chosen], settings.temperature)

    return Term(name="depth order", loss=loss, weight=settings.global_weight)


def local_terms(settings: DepthSettings, unit: float) -> tuple[Term, ...]:
    """Steps of depth between neighbours, and soft ranks off their neighbourhood's, away from edges.

    Twins of `depth_supervision.smoothness_loss`, on the whole image, and of `outlier_loss`, on a crop
    drawn at random, since ranking is quadratic in the pixels. Pixels that a mask hides are left out: no
    step leads to one, and none is ranked. A photo's edges are found once.

    Args:
        settings: Weights, edge of the crop, threshold, temperature.
        unit: Unit of length that depths are divided by, in scene units.

    Source: HDGS, Eqs. 12 and 13.
    """
    edges = TensorCache(KEPT_BYTES)

    def weights(frame: Frame) -> Float[Tensor, "h w"]:
        return edges.get(frame.view, lambda: edge_weight(frame.truth, settings.beta))

    def smooth(frame: Frame) -> Float[Tensor, ""]:
        weight, depth = weights(frame), frame.output.depth
        across = weight[:, :-1] * (depth[:, 1:] - depth[:, :-1]).abs()
        down = weight[:-1] * (depth[1:] - depth[:-1]).abs()
        if (mask := frame.mask) is None:
            return (across.sum() + down.sum()) / (depth.numel() * unit)
        across, down = across * (mask[:, 1:] & mask[:, :-1]), down * (mask[1:] & mask[:-1])
        return (across.sum() + down.sum()) / (mask.sum().clamp(min=1) * unit)

    def outliers(frame: Frame) -> Float[Tensor, ""]:
        depth, side = frame.output.depth, settings.crop
        draw = torch.rand(2, generator=frame.moment.generator).tolist()
        row, column = (
            int(share * max(1, size - side + 1))
            for share, size in zip(draw, depth.shape, strict=True)
        )
        crop = (slice(row, row + side), slice(column, column + side))
        part, weight = depth[crop], weights(frame)[crop]
        counts = torch.ones_like(part).bool() if frame.mask is None else frame.mask[crop]
        values = part[counts]
        ranks = soft_rank(standardised(values), settings.temperature) / max(1, len(values))
        image = torch.zeros_like(part).masked_scatter(counts, ranks)
        return weighted_outliers(image, weight, settings.delta, counts)

    made = (
        Term(name="depth steps", loss=smooth, weight=settings.smooth),
        Term(name="depth outliers", loss=outliers, weight=settings.outlier),
    )
    return tuple(term for term in made if term.weight)


def weighted_outliers(
    ranks: Float[Tensor, "h w"],
    weight: Float[Tensor, "h w"],
    delta: float,
    counts: Bool[Tensor, "h w"],
) -> Float[Tensor, ""]:
    """1/N sum w e over the pixels where e, the rank's distance to its neighbourhood's mean, is large.

    0 where no pixel counts.

    Args:
        ranks: Soft ranks, divided by the number of pixels that count; 0 elsewhere.
        weight: Weight of each pixel, from `edge_weight`.
        delta: What e must be above.
        counts: The N pixels that count, as neighbours too.
    """
    if not bool(counts.any()):
        return ranks.new_zeros(())
    total, share = functional.avg_pool2d(
        torch.stack([ranks, counts.to(ranks)])[:, None],
        3, stride=1, padding=1, count_include_pad=False,
    )[:, 0]  # fmt: skip
    off = (ranks - total / share.clamp(min=0.1)).abs()
    return (weight * torch.where(off > delta, off, 0))[counts].mean()
