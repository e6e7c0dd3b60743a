"""Method absgs: 3dgs that splits large Gaussians by gradients that do not cancel."""

from dataclasses import dataclass, field

from splatproof.methods.contracts.method import Method
from splatproof.methods.threedgs.cost import cost
from splatproof.methods.threedgs.fit import fit
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density


@dataclass(frozen=True, kw_only=True)
class AbsDensity(Density):
    """Density control with the thresholds of the AbsGS release."""

    split_gradient: float = 4e-4
    """As for 3dgs; here it is on."""
    split_size: float = 1e-3
    """Largest scale, in extents, up to which a Gaussian is cloned; a larger one is split."""


@dataclass(frozen=True, kw_only=True)
class AbsGS(Settings):
    """Method absgs: 3dgs with other density control. Steps are those of a 30,000 iteration run."""

    density: AbsDensity = field(default_factory=AbsDensity)


ABSGS = Method(
    name="absgs",
    settings=AbsGS,
    fit=fit,
    cost=cost,
    description="3dgs whose large Gaussians are split by the sum of absolute gradients, which do not "
    "cancel over a blurred texture (AbsGS, Ye et al. 2024)",
)
