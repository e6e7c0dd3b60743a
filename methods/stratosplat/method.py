"""Method stratosplat as the registry knows it."""

from splatproof.methods.contracts.method import Method
from splatproof.methods.models.decoded import loader
from splatproof.methods.stratosplat.cost import cost
from splatproof.methods.stratosplat.fit import KIND, fit
from splatproof.methods.stratosplat.model import restored
from splatproof.methods.stratosplat.settings import StratoSplat

STRATOSPLAT = Method(
    name="stratosplat",
    settings=StratoSplat,
    fit=fit,
    cost=cost,
    description="StratoSplat (Gao et al. 2026): depths of few aerial photos completed under a layered "
    "memory, explicit Gaussians beside virtual ones on parallel planes, which a field decodes",
    loaders={KIND: loader(KIND, restored)},
)
