"""The explicit model: raw parameters of Gaussians and their activations."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional


@dataclass(frozen=True, kw_only=True, eq=False)
class Gaussians:
    """Raw (unconstrained) parameters as they are optimised and stored in .ply files.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 5; file layout of its release.
    """

    means: Float[Tensor, "n 3"]
    """World positions in scene units."""
    quaternions: Float[Tensor, "n 4"]
    """(w, x, y, z), normalised on use."""
    log_scales: Float[Tensor, "n 3"]
    """Natural logarithm of the standard deviation on each local axis."""
    opacity_logits: Float[Tensor, " n"]
    """Opacity before the sigmoid."""
    sh: Float[Tensor, "n k 3"]
    """Spherical-harmonic coefficients, DC first; k = (degree + 1)^2 with degree 0 to 3."""

    def __len__(self) -> int:
        """Return the number of Gaussians."""
        return len(self.means)

    @property
    def scales(self) -> Float[Tensor, "n 3"]:
        """Standard deviations in scene units."""
        return self.log_scales.exp()

    @property
    def opacities(self) -> Float[Tensor, " n"]:
        """Opacity in (0, 1)."""
        return torch.sigmoid(self.opacity_logits)

    @property
    def unit_quaternions(self) -> Float[Tensor, "n 4"]:
        """Quaternions of norm 1 (a zero one stays zero: the rasterizers read it as identity)."""
        return functional.normalize(self.quaternions, dim=-1)

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]
