"""Depth terms of rendered views: the order of a depth prior, smoothness, and outliers."""

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.datasets.image_cache import TensorCache
from splatproof.methods.hdgs.settings import DepthSettings
from splatproof.methods.training.terms import Frame, Term
from splatproof.reference.supervision.depth_supervision import outlier_loss, smoothness_loss
from splatproof.reference.supervision.soft_rank import (
    global_depth_loss,
    soft_rank,
    standardised,
)
from splatproof.reference.types.scene import Scene

KEPT_BYTES = 2**28
"""Most bytes of depth priors that are kept between steps."""
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
        require_prior(scene)
        terms.append(order_term(settings))
    if settings.smooth:
        terms.append(smooth_term(settings, unit))
    if settings.outlier:
        terms.append(outlier_term(settings))
    return tuple(terms)


def require_prior(scene: Scene) -> None:
    """Refuse a scene of whose training views none has a depth prior.

    Raises: DataError.
    """
    if all(view.load_prior is None for view in scene.train_views):
        raise DataError(
            f"scene {scene.name!r}: no training view has a depth prior; name one for the case, or "
            "set depth.global_weight = 0 to do without"
        )


def order_term(settings: DepthSettings) -> Term:
    """1 - rank correlation of rendered disparity and prior, at pixels drawn at random.

    Disparities are compared, not depths: a prior's zero point is unknown, so that its inverse may
    have another order.

    Args:
        settings: Number of pixels, temperature, weight.

    Source: HDGS, Eqs. 9 to 11; on a sample, since the direct form is quadratic in it.
    """
    disparities, masks = TensorCache(KEPT_BYTES), TensorCache(KEPT_BYTES)

    def loss(frame: Frame) -> Float[Tensor, ""]:
        load, depth = frame.view.load_prior, frame.output.depth
        if load is None:
            return depth.new_zeros(())
        prior = disparities.get(frame.view, lambda: load().disparity).to(depth)
        valid = masks.get(frame.view, lambda: load().valid).to(depth.device)
        counts = valid & (frame.output.alpha.detach() > DRAWN)
        if frame.mask is not None:
            counts = counts & frame.mask
        (pixels,) = torch.where(counts.flatten())
        drawn = torch.randperm(len(pixels), generator=frame.moment.generator)
        chosen = pixels[drawn[: settings.pixels].to(pixels)]
        near = frame.view.camera.near
        rendered = 1 / depth.flatten()[chosen].clamp(min=near)
        return global_depth_loss(rendered, prior.flatten()[chosen], settings.temperature)

    return Term(name="depth order", loss=loss, weight=settings.global_weight)


def smooth_term(settings: DepthSettings, unit: float) -> Term:
    """Steps of depth between neighbours where the photo has no edge.

    Args:
        settings: Weight, and how fast edges of the photo excuse edges of depth.
        unit: Unit of length that depths are divided by, in scene units.
    """

    def loss(frame: Frame) -> Float[Tensor, ""]:
        return smoothness_loss(frame.output.depth / unit, frame.truth, settings.beta)

    return Term(name="depth smooth", loss=loss, weight=settings.smooth)


def outlier_term(settings: DepthSettings) -> Term:
    """Soft ranks of depth far from their neighbourhood's, in a crop drawn at random.

    Args:
        settings: Edge of the crop, threshold, temperature, weight.

    Source: HDGS, Eq. 13; on a crop, since the direct form is quadratic in it.
    """

    def loss(frame: Frame) -> Float[Tensor, ""]:
        depth, side = frame.output.depth, settings.crop
        low = [max(1, size - side + 1) for size in depth.shape]
        draw = torch.rand(2, generator=frame.moment.generator).tolist()
        row, column = (int(share * most) for share, most in zip(draw, low, strict=True))
        part = depth[row : row + side, column : column + side]
        photo = frame.truth[row : row + side, column : column + side]
        ranks = soft_rank(standardised(part.flatten()), settings.temperature) / part.numel()
        return outlier_loss(ranks.reshape(part.shape), photo, settings.beta, settings.delta)

    return Term(name="depth outliers", loss=loss, weight=settings.outlier)
