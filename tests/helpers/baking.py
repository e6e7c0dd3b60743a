"""Explicit Gaussians of a reconstruction, for tests that know that it has some."""

from splatproof.methods.contracts.reconstruction import Bakes, Reconstruction
from splatproof.reference.types.gaussians import Gaussians


def baked(model: Reconstruction) -> Gaussians:
    """What the model bakes to."""
    assert isinstance(model, Bakes)
    return model.bake()
