"""Method scaffold-gs as the registry knows it."""

from splatproof.methods.anchors.model import restored
from splatproof.methods.contracts.method import Method
from splatproof.methods.models.decoded import loader
from splatproof.methods.scaffold.cost import cost
from splatproof.methods.scaffold.fit import KIND, fit
from splatproof.methods.scaffold.settings import Settings

SCAFFOLD_GS = Method(
    name="scaffold-gs",
    settings=Settings,
    fit=fit,
    cost=cost,
    description="Scaffold-GS (Lu et al. 2024): voxel anchors whose Gaussians networks decode for each "
    "view, growing at three levels, pruning, volume term",
    loaders={KIND: loader(KIND, restored)},
)
