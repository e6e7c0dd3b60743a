"""What is optional on Splats, for tests that know that it is there."""

from torch import Tensor

from splatproof.reference.types.splats import Splats


def colours(splats: Splats) -> Tensor:
    """The colours of splats that have some."""
    assert splats.colours is not None
    return splats.colours


def slots(splats: Splats) -> Tensor:
    """The slots of splats that tell them apart."""
    assert splats.slots is not None
    return splats.slots
