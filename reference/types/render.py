"""What a rasterizer returns."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderOutput:
    """One rendered image and what was asked for beside it.

    All float outputs but weights and radii are differentiable.
    """

    colour: Float[Tensor, "h w c"]
    """Blended colour over the background; not clamped."""
    alpha: Float[Tensor, "h w"]
    """1 - final transmittance, in [0, 1)."""
    depth: Float[Tensor, "h w"]
    """Expected z-depth, sum(w z) / sum(w), in scene units; 0 where nothing is drawn."""
    radii: Float[Tensor, " n"]
    """Longer half-extent of each Gaussian's support in pixels; 0 where it is not seen."""
    distance: Float[Tensor, "h w"] | None = None
    """Expected distance to the camera centre, sum(w |mu - c|) / sum(w); 0 where empty."""
    median_depth: Float[Tensor, "h w"] | None = None
    """z of the contribution that takes transmittance to 0.5 or below; 0 where none does."""
    contributor_ids: Int[Tensor, "h w k"] | None = None
    """Indices of the k Gaussians of largest weight, largest first, ties nearest first; -1: none."""
    contributor_weights: Float[Tensor, "h w k"] | None = None
    """Compositing weights alpha_i T_i of these contributors; 0 where there is none."""

    def to(self, device: torch.device | str) -> "RenderOutput":
        """The same result with every tensor on a device.

        Args:
            device: Where to.
        """
        moved = {name: value.to(device) for name, value in vars(self).items() if value is not None}
        return replace(self, **moved)
