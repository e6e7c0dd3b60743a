"""What rasterizers take and give gradients to: the activated primitives of one view."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.reference.types.gaussians import Gaussians


@dataclass(frozen=True, kw_only=True, eq=False)
class Splats:
    """Activated Gaussians as one view sees them, and where each was decoded from."""

    means: Float[Tensor, "n 3"]
    """World positions in scene units."""
    quaternions: Float[Tensor, "n 4"]
    """(w, x, y, z) of any norm; the rasterizers normalise them."""
    scales: Float[Tensor, "n 3"]
    """Standard deviations in scene units, >= 0."""
    opacities: Float[Tensor, " n"]
    """Opacities in [0, 1]."""
    sh: Float[Tensor, "m k 3"] | None = None
    """Spherical-harmonic coefficients, k in {1, 4, 9, 16}; beside `colours`, of the first m splats."""
    colours: Float[Tensor, "u c"] | None = None
    """Colours of 1 to 32 channels; beside `sh`, those of the other u = n - m splats, 3 channels."""
    rows: Int[Tensor, " n"] | None = None
    """Row of the model that each splat was decoded from; -1: from none (virtual). None: splat i is
    row i."""
    slots: Int[Tensor, " n"] | None = None
    """Where a row decodes to several splats: row * k + place among its k. None: not told apart."""
    decoded: Int[Tensor, " v"] | None = None
    """Rows that were decoded for this view, whether they show a splat or not. None: all were."""

    def __post_init__(self) -> None:
        """Refuse splats with no colour or two."""
        given = [len(values) for values in (self.sh, self.colours) if values is not None]
        if not given or sum(given) != len(self):
            raise ValueError(f"{len(self)} splats with colours and harmonics of {given}")

    def __len__(self) -> int:
        """Return the number of splats."""
        return len(self.means)

    def to(self, device: torch.device | str) -> "Splats":
        """The same splats on a device.

        Args:
            device: Where to.
        """
        moved = {name: value.to(device) for name, value in vars(self).items() if value is not None}
        return replace(self, **moved)


def activated(gaussians: Gaussians) -> Splats:
    """The splats of explicit Gaussians: row i is splat i, from wherever it is seen."""
    return Splats(
        means=gaussians.means, quaternions=gaussians.quaternions, scales=gaussians.scales,
        opacities=gaussians.opacities, sh=gaussians.sh,
    )  # fmt: skip
