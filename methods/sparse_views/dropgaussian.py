"""Method dropgaussian: 3dgs that hides Gaussians at random while it trains."""

from dataclasses import dataclass, field

from splatproof.methods.contracts.method import Method
from splatproof.methods.threedgs.cost import cost
from splatproof.methods.threedgs.fit import fit
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density


@dataclass(frozen=True, kw_only=True)
class DropDensity(Density):
    """Density control with the values of DropGaussian's release, whose 10,000 steps are 30,000
    here."""

    start: int = 1500
    """Last step without densification: Gaussians are cloned, split and removed after it."""
    stop: int = 30_000
    """Step from which on nothing is densified and no opacity is reset."""
    interval: int = 300
    """Steps between densifications; a short run shrinks it to no less than `least_interval`, unless
    `fewest` asks for more densifications."""
    gradient: float = 4.2e-4
    """Pull from which a Gaussian is cloned or split: mean norm of the loss's gradient by its
    position in the image, in units of half the image (the release: 5e-4 of a loss 1.2 times as
    large)."""
    reset_interval: int = 9000
    """Steps between opacity resets, which leave no Gaussian more opaque than 0.01; 0: never."""


@dataclass(frozen=True, kw_only=True)
class DropGaussian(Settings):
    """Method dropgaussian: 3dgs with dropout. Steps are those of a 30,000 step run; the release's
    10,000 are stretched to it."""

    sh_interval: int = 3000
    """Steps after which each further SH degree is trained; 0: all from the start."""
    dssim: float = 1 / 6
    """Weight of 1 - SSIM in the loss, 0 to 1; L1 has the rest (the release: L1 + 0.2 (1 - SSIM),
    which is 1.2 times this)."""
    dropout: float = 0.2
    """Share of Gaussians, 0 to below 1, that a step hides at random, growing linearly from 0 to
    this at the last step. 0: none, an ablation of the paper."""
    density: DropDensity = field(default_factory=DropDensity)
    """When and where Gaussians are added and removed."""


DROPGAUSSIAN = Method(
    name="dropgaussian",
    settings=DropGaussian,
    fit=fit,
    cost=cost,
    description="3dgs for few views: a growing share of Gaussians is hidden at random in each step, the "
    "others made up for it (Park et al. 2025)",
)
