"""Method dlg-gs as the registry knows it."""

from splatproof.methods.contracts.method import Method
from splatproof.methods.dlg_gs.cost import cost
from splatproof.methods.dlg_gs.fit import KIND, fit
from splatproof.methods.dlg_gs.model import restored
from splatproof.methods.dlg_gs.settings import Settings
from splatproof.methods.models.decoded import loader

DLG_GS = Method(
    name="dlg-gs",
    settings=Settings,
    fit=fit,
    cost=cost,
    description="DLG-GS (Li et al. 2026): scaffold-gs whose colours adapt to a moving light, by "
    "statistics of each photo and attention between anchors; depth priors hold anchors and Gaussians",
    loaders={KIND: loader(KIND, restored)},
)
