"""Sequential depth adaptation: each view's depth is denoised under the memory of the earlier ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.reference.layered_memory import guide_depth, layered_depth
from splatproof.reference.layered_memory.layered_depth import LayeredDepth
from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.types.camera import Camera, project_points

BETAS, EPSILON = (0.9, 0.999), 1e-8
"""Constants of Adam, as its paper has them."""


@runtime_checkable
class DepthDenoiser(Protocol):
    """A depth model that predicts in steps, so that guidance can act between them."""

    steps: int

    def start(
        self, image: Float[Tensor, "h w 3"], generator: torch.Generator
    ) -> Float[Tensor, "..."]:
        """Return the noisy latent x_T that denoising starts from.

        Args:
            image: The view's photo, sRGB in [0, 1].
            generator: Source of the noise.
        """
        ...

    def predict_clean(
        self, latent: Float[Tensor, "..."], image: Float[Tensor, "h w 3"], step: int
    ) -> Float[Tensor, "..."]:
        """Return the clean latent x_0 as the network estimates it; called without gradient.

        Args:
            latent: The latent x_t before this step.
            image: The view's photo, sRGB in [0, 1].
            step: Number of the step, from 0 to steps - 1.
        """
        ...

    def advance(
        self, latent: Float[Tensor, "..."], clean: Float[Tensor, "..."], step: int
    ) -> Float[Tensor, "..."]:
        """Return x_(t-1): what the model's own scheduler makes of x_t and x_0, without gradient.

        Args:
            latent: The latent x_t before this step.
            clean: The estimate of x_0 after guidance.
            step: Number of the step, from 0 to steps - 1.
        """
        ...

    def decode(
        self, latent: Float[Tensor, "..."], image: Float[Tensor, "h w 3"]
    ) -> Float[Tensor, "h w"]:
        """Return the depth in [0, 1] of a clean latent; differentiable by the latent.

        Args:
            latent: A clean latent.
            image: The view's photo, sRGB in [0, 1]; a decoder that needs no photo ignores it.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class AdaptationSettings:
    """How strongly and how long the geometry pulls on the prediction."""

    visible_weight: float = 0.1
    """lambda_vis: weight of the memory's guide depth in the loss (paper, Sec. 4)."""
    guidance_steps: int = 20
    """Optimiser steps at each denoising step (ours; the paper names none)."""
    learning_rate: float = 0.2
    """Step size of Adam for the latent, log a, and b in units of the known depths' spread, at the first
    denoising step; 1/2, 1/3, ... of it at the next ones: L1 pulls alike however near it is, and
    constant steps only swing about the depth (chosen on the made-up depths of the tests)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseDepths:
    """Depths of SfM points in one view."""

    rows: Int[Tensor, " n"]
    columns: Int[Tensor, " n"]
    depths: Float[Tensor, " n"]


def sparse_depths(camera: Camera, points: Float[Tensor, "n 3"]) -> SparseDepths:
    """z-depths of the points that land in the image, at the pixel they land in.

    Args:
        camera: The view's camera; points nearer than its near plane are left out.
        points: World positions of the SfM points that the view sees, scene units.
    """
    at, z = project_points(camera, points)
    size = at.new_tensor([camera.width, camera.height])
    inside = (z > camera.near) & (at >= 0).all(dim=1) & (at < size).all(dim=1)
    column, row = at[inside].long().unbind(dim=1)
    return SparseDepths(rows=row, columns=column, depths=z[inside])


def depths_of(guide: Float[Tensor, "h w"], visible: Bool[Tensor, "h w"]) -> SparseDepths:
    """The guide depth at the pixels where there is one, as if they were sparse points.

    Args:
        guide: Guide depth of the memory in scene units.
        visible: Pixels where the memory has a depth.
    """
    rows, columns = torch.where(visible)
    return SparseDepths(rows=rows, columns=columns, depths=guide[visible])


TRUSTED = 0.3
"""Correlation of prediction and sparse depths from which a fitted scale is believed."""


def align(
    prediction: Float[Tensor, "h w"], sparse: SparseDepths
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Scale and shift (a, b) that take the prediction in [0, 1] to the sparse depths.

    Least squares, where prediction and depths agree at all (correlation >= 0.3). A prediction that
    does not vary over the points, or contradicts them, says nothing about the scale: it is then
    given the points' own range, b = min and a = max - min; with fewer than two distinct depths a
    is 1 and b the mean difference; without any point (1, 0). So a is never negative: that would
    turn the depth inside out.

    Args:
        prediction: Depth in [0, 1] as the denoiser predicts it.
        sparse: True depths at some of its pixels, scene units; there may be none.

    Source: StratoSplat, Sec. 3.2 (learnable scale-shift); the start and its fallbacks: ours.
    """
    one = prediction.new_ones(())
    if not len(sparse.depths):
        return one, prediction.new_zeros(())
    here = prediction[sparse.rows, sparse.columns]
    depths = sparse.depths.to(prediction)
    x, y = here - here.mean(), depths - depths.mean()
    power = (x * x).sum() * (y * y).sum()
    varies = power > 1e-24 * len(here) ** 2
    if varies and (x * y).sum() >= TRUSTED * power.sqrt():
        a = (x * y).sum() / (x * x).sum()
        return a, depths.mean() - a * here.mean()
    spread = depths.amax() - depths.amin()
    if spread > 0:
        return spread, depths.amin()
    return one, depths.mean() - here.mean()


def guidance_loss(
    depth: Float[Tensor, "h w"],
    sparse: SparseDepths,
    guide: Float[Tensor, "h w"],
    visible: Bool[Tensor, "h w"],
    visible_weight: float,
) -> Float[Tensor, ""]:
    """L = sum_sparse |D - d_sfm| + lambda_vis |(D - D_guide) M_vis|_1, in scene units.

    Args:
        depth: Aligned prediction a D + b, scene units.
        sparse: Depths of SfM points in the view, scene units.
        guide: Guide depth of the memory in scene units; only read where visible.
        visible: Pixels where the memory has a depth.
        visible_weight: Weight lambda_vis >= 0 of the guide depth.

    Source: StratoSplat, Eqs. 3 and 4.
    """
    at_points = depth[sparse.rows, sparse.columns] - sparse.depths.to(depth)
    at_guide = torch.where(visible, depth - guide.to(depth), 0)
    return at_points.abs().sum() + visible_weight * at_guide.abs().sum()


def depth_unit(
    sparse: SparseDepths, guide: Float[Tensor, "h w"], visible: Bool[Tensor, "h w"]
) -> float:
    """Length that depths are divided by, so that guidance takes the same steps in every scene.

    The range of the known depths, sparse and guide, without the lowest and the highest hundredth:
    one wrong point must not set it. Where they are all alike it is their size; with none it is 1.

    Args:
        sparse: Depths of SfM points in the view, scene units.
        guide: Guide depth of the memory in scene units; only read where visible.
        visible: Pixels where the memory has a depth.

    Returns: The unit in scene units, > 0.

    Source: ours (Adam's steps have the size of its learning rate, whatever the gradient's).
    """
    known = torch.cat([sparse.depths.to(guide), guide[visible]]).sort().values
    if not len(known):
        return 1.0
    last = len(known) - 1
    low, high = float(known[int(0.01 * last)]), float(known[last - int(0.01 * last)])
    alike = high - low <= 1e-6 * abs(high)
    return (abs(high) or 1.0) if alike else high - low


def adapt_view(
    denoiser: DepthDenoiser,
    image: Float[Tensor, "h w 3"],
    sparse: SparseDepths,
    guide: Float[Tensor, "h w"],
    visible: Bool[Tensor, "h w"],
    settings: AdaptationSettings,
    generator: torch.Generator,
) -> Float[Tensor, "h w"]:
    """z-depth of one view: at every denoising step x_0, a and b follow the guidance loss.

    The network estimates x_0 from x_t; guidance moves x_0 through the decoder alone; the model's
    scheduler takes x_t and the guided x_0 to x_(t-1). All in units of `depth_unit`. A view without
    any point takes its first scale and shift from the guide.

    Args:
        denoiser: Predicts depth from the photo, step by step.
        image: The view's photo, sRGB in [0, 1].
        sparse: Depths of SfM points in the view, scene units.
        guide: Guide depth of the memory in scene units; only read where visible.
        visible: Pixels where the memory has a depth.
        settings: Weight of the guide, and steps and learning rate of the guidance.
        generator: Source of the denoiser's noise.

    Returns: Depth in scene units, without gradient.

    Source: StratoSplat, Sec. 3.2, "Sequential Depth Adaptation".
    """
    unit = depth_unit(sparse, guide, visible)
    sparse, guide = replace(sparse, depths=sparse.depths / unit), guide / unit
    latent = denoiser.start(image, generator)
    with torch.no_grad():
        clean = denoiser.predict_clean(latent, image, 0)
        known = sparse if len(sparse.depths) else depths_of(guide, visible)
        scale, shift = align(denoiser.decode(clean, image), known)
    log_scale = scale.log()
    for step in range(denoiser.steps):
        free = [value.clone().requires_grad_() for value in (clean, log_scale, shift)]
        moments = [(torch.zeros_like(value), torch.zeros_like(value)) for value in free]
        for number in range(1, settings.guidance_steps + 1):
            depth = free[1].exp() * denoiser.decode(free[0], image) + free[2]
            loss = guidance_loss(depth, sparse, guide, visible, settings.visible_weight)
            gradients = torch.autograd.grad(loss, free)
            _adam(free, gradients, moments, settings.learning_rate / (1 + step), number)
        clean, log_scale, shift = (value.detach() for value in free)
        with torch.no_grad():
            latent = denoiser.advance(latent, clean, step)
            if step + 1 < denoiser.steps:
                clean = denoiser.predict_clean(latent, image, step + 1)
    with torch.no_grad():
        return unit * (log_scale.exp() * denoiser.decode(latent, image) + shift)


@torch.no_grad()
def _adam(
    values: list[Tensor],
    gradients: Sequence[Tensor],
    moments: list[tuple[Tensor, Tensor]],
    rate: float,
    number: int,
) -> None:
    """Update `number` of values and moments in place (Kingma and Ba 2015, Algorithm 1).

    torch.optim.Adam, when it is first made, imports torch's compiler: seconds of each process.
    """
    for value, gradient, (first, second) in zip(values, gradients, moments, strict=True):
        first += (1 - BETAS[0]) * (gradient - first)
        second += (1 - BETAS[1]) * (gradient**2 - second)
        root = (second / (1 - BETAS[1] ** number)).sqrt() + EPSILON
        value -= rate / (1 - BETAS[0] ** number) * first / root


def adapt_all(
    denoiser: DepthDenoiser,
    cameras: list[Camera],
    images: list[Float[Tensor, "h w 3"]],
    points: Float[Tensor, "n 3"],
    seen: Bool[Tensor, "v n"],
    order: list[int],
    memory: LayeredDepth,
    settings: AdaptationSettings,
    generator: torch.Generator,
    report: Callable[[int], None] = lambda view: None,
) -> tuple[LayeredDepth, dict[int, Float[Tensor, "h w"]]]:
    """Adapt the views in order; each one's depth enters the memory that guides the next.

    Args:
        denoiser: Predicts depth from a photo, step by step.
        cameras: Cameras of all views.
        images: Photos of all views, sRGB in [0, 1], each as large as its camera's image.
        points: SfM points in the world, scene units.
        seen: Which view's track holds which point.
        order: Indices of the views to adapt, first to last.
        memory: LDI that holds the sparse points, or is empty.
        settings: Weight of the guide, and steps and learning rate of the guidance.
        generator: Source of the denoiser's noise.
        report: Called with each view's index when it is done.

    Returns: The final memory, whose layers are P_dense, and each view's z-depth.
    """
    depths = {}
    for view in order:
        camera, image = cameras[view], images[view]
        guide, visible = guide_depth.render(memory, camera)
        sparse = sparse_depths(camera, points[seen[view]])
        depth = adapt_view(denoiser, image, sparse, guide, visible, settings, generator)
        depths[view] = depth
        in_front = depth.reshape(-1) > camera.near
        memory = layered_depth.insert(
            memory, unproject(camera, depth)[in_front], image.reshape(-1, 3)[in_front]
        )
        report(view)
    return memory, depths


def order_by_coverage(seen: Bool[Tensor, "v n"]) -> list[int]:
    """Views with the most SfM points first; ties by index."""
    return torch.sort(seen.sum(dim=1), descending=True, stable=True).indices.tolist()


def order_by_distance(centres: Float[Tensor, "v 3"], reference: Float[Tensor, "3"]) -> list[int]:
    """Views nearest to the reference camera first; ties by index.

    Args:
        centres: Camera centres of the views, scene units.
        reference: Centre of the reference camera, scene units.
    """
    return torch.sort((centres - reference).norm(dim=1), stable=True).indices.tolist()


def order_at_random(count: int, generator: torch.Generator) -> list[int]:
    """A random order, as the paper's Table 4 compares with.

    Args:
        count: Number of views.
        generator: Source of the order.
    """
    return torch.randperm(count, generator=generator).tolist()
