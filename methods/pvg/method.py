"""Method pvg as the registry knows it."""

from splatproof.methods.contracts.method import Method
from splatproof.methods.models.decoded import loader
from splatproof.methods.pvg.cost import cost
from splatproof.methods.pvg.fit import KIND, fit
from splatproof.methods.pvg.model import restored
from splatproof.methods.pvg.settings import Settings

PVG = Method(
    name="pvg",
    settings=Settings,
    fit=fit,
    cost=cost,
    description="Periodic Vibration Gaussian (Chen et al. 2023): each swings about its centre and fades "
    "around its moment; LiDAR returns at the start, depth and sky terms, a learnt sky",
    loaders={KIND: loader(KIND, restored)},
)
