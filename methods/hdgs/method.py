"""Method hdgs as the registry knows it."""

from splatproof.methods.contracts.method import Method
from splatproof.methods.hdgs.cost import cost
from splatproof.methods.hdgs.fit import KIND, fit
from splatproof.methods.hdgs.model import restored
from splatproof.methods.hdgs.settings import Settings
from splatproof.methods.models.decoded import loader

HDGS = Method(
    name="hdgs",
    settings=Settings,
    fit=fit,
    cost=cost,
    description="HDGS (Ge et al.): few anchors that vibrate, refined layer by layer into the Gaussians "
    "of a moment; support between neighbours, depth order, growing by gradient and density",
    loaders={KIND: loader(KIND, restored)},
)
