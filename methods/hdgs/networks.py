"""The networks of the hierarchy and of its consistency step, drawn and kept as shared tensors."""

from collections.abc import Mapping

import torch
from torch import Tensor

from splatproof.methods.anchors.networks import named, network
from splatproof.reference.anchors import support_network
from splatproof.reference.anchors.motion_hierarchy import (
    HierarchyNetworks,
    HierarchySettings,
    LayerNetworks,
    create_networks,
)
from splatproof.reference.anchors.support_network import SupportNetwork

HEADS = ("colour", "opacity", "shape")
RESIDUALS = ("position", "feature", "scale")
SUPPORT = ("modulation", "residual", "gate")
CONVOLUTION = "ice_convolution"
"""Name of the weights of the sparse convolution, where there is a consistency step."""


def drawn(sizes: HierarchySettings, seed: int, *, ice: bool) -> dict[str, Tensor]:
    """All networks at their start, as named tensors.

    Args:
        sizes: Sizes of the hierarchy.
        seed: Seed of the draw.
        ice: Whether there is a consistency step.
    """
    generator = torch.Generator().manual_seed(seed)
    made = create_networks(sizes, generator)
    networks = {"leaf_position": made.leaf_position}
    networks |= {name: getattr(made, name) for name in HEADS}
    for i, layer in enumerate(made.layers, start=1):
        networks |= {f"layer{i}_{name}": getattr(layer, name) for name in RESIDUALS}
    if not ice:
        return named(networks)
    support = support_network.create(sizes.features, generator, torch.float32)
    networks |= {f"ice_{name}": getattr(support, name) for name in SUPPORT}
    return named(networks) | {CONVOLUTION: support.convolution}


def hierarchy(shared: Mapping[str, Tensor], layers: int) -> HierarchyNetworks:
    """The networks of the hierarchy; the same tensors, so gradients reach them.

    Args:
        shared: As `drawn` names them; others are passed over.
        layers: Layers of the hierarchy.

    Raises: KeyError if one is missing.
    """
    return HierarchyNetworks(
        layers=tuple(
            LayerNetworks(**{name: network(f"layer{i}_{name}", shared) for name in RESIDUALS})
            for i in range(1, layers - 1)
        ),
        leaf_position=network("leaf_position", shared),
        **{name: network(name, shared) for name in HEADS},
    )


def support(shared: Mapping[str, Tensor]) -> SupportNetwork:
    """The networks of the consistency step.

    Args:
        shared: As `drawn` names them.

    Raises: KeyError if one is missing.
    """
    parts = {name: network(f"ice_{name}", shared) for name in SUPPORT}
    return SupportNetwork(convolution=shared[CONVOLUTION], **parts)
