"""New Gaussians where photos show what renders do not: on pixels with large errors, at the render's depth."""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.methods.threedgs.scored_views import ScoredView
from splatproof.reference.rasterizer.spherical_harmonics import C0


@torch.no_grad()
def inserted(
    views: Sequence[ScoredView],
    count: int,
    *,
    size: float,
    opacity: float,
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """Up to so many new Gaussians, as many of each view, as a GaussianModel's tensors; harmonics are left out.

    A pixel is drawn with a weight that is its error, once at most, where something is drawn and the
    pixel counts. The Gaussian has the photo's colour, no rotation, and one scale.

    Args:
        views: Rendered views, at least one.
        count: How many; fewer where fewer pixels show anything.
        size: Scale in pixels of the photo, at the pixel's depth.
        opacity: Opacity of each, between 0 and 1.
        generator: Source of the pixels.

    Source: ours; that new Gaussians begin on pixels with large errors, at rendered depth, is common to
        several systems of simultaneous mapping.
    """
    means, scales, colours = [], [], []
    for number, view in enumerate(views):
        quota = (number + 1) * count // len(views) - number * count // len(views)
        error = (view.image - view.truth).abs().mean(dim=2)
        weights = error.where(view.depth > 0, 0)
        if view.valid is not None:
            weights = weights.where(view.valid, 0)
        pixels = by_weight(weights.flatten().cpu(), quota, generator).to(error.device)
        depth = view.depth.flatten()[pixels]
        means.append(lifted(view, pixels, depth))
        focal = float(view.camera.K[[0, 1], [0, 1]].mean())
        scales.append(size * depth / focal)
        colours.append(view.truth.reshape(-1, 3)[pixels])
    made = torch.cat(scales)
    total = len(made)
    return {
        "means": torch.cat(means),
        "log_scales": made.log()[:, None].repeat(1, 3),
        "quaternions": made.new_tensor([1.0, 0, 0, 0]).repeat(total, 1),
        "opacity_logits": made.new_full((total,), opacity).logit(),
        "sh_dc": ((torch.cat(colours) - 0.5) / C0)[:, None],
    }


def lifted(
    view: ScoredView, pixels: Int[Tensor, " k"], depth: Float[Tensor, " k"]
) -> Float[Tensor, "k 3"]:
    """World positions of the centres of pixels, in scene units.

    Args:
        view: The view that they are of.
        pixels: Number of each pixel, row by row.
        depth: Depth of each along the camera's axis, in scene units.
    """
    camera = view.camera.to(torch.float64)
    x, y = pixels % camera.width + 0.5, pixels // camera.width + 0.5
    places = torch.stack([x, y, torch.ones_like(x)], dim=1).cpu().double()
    local = depth.cpu().double()[:, None] * (places @ torch.linalg.inv(camera.K).T)
    return ((local - camera.translation) @ camera.rotation).to(depth)


def by_weight(
    weights: Float[Tensor, " n"], count: int, generator: torch.Generator
) -> Int[Tensor, " k"]:
    """Indices drawn one after the other without replacement, each in proportion to its weight.

    Args:
        weights: Weights >= 0, on the CPU.
        count: Number of draws; fewer where fewer weights are above 0.
        generator: Source of the draws.

    Source: Efraimidis and Spirakis 2006, "Weighted random sampling with a reservoir": the largest of
        u^(1/w), here as log(u) / w.
    """
    draws = torch.rand(len(weights), generator=generator, dtype=torch.float64)
    keys = draws.log() / weights.double()
    keys = keys.where(weights > 0, -torch.inf)
    order = torch.sort(keys, descending=True, stable=True).indices
    return order[: min(count, int((weights > 0).sum()))]
