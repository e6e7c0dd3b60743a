"""HDGS's consistency step: anchors of neighbouring voxels support one another's features."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.hdgs.consistency import pairs, supported_by_products
from splatproof.methods.kernels import support as native
from splatproof.reference.anchors import support_network
from splatproof.reference.anchors.support_network import SupportNetwork
from splatproof.reference.types.mlp import Mlp
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

CHANNELS = 32
"""Numbers of an anchor's feature, as in method hdgs."""
FILLED = 0.3
"""Share of the cube's voxels that hold an anchor: eight of the 27 around one, and itself."""
NETWORKS = {"modulation": 2, "gate": 2, "residual": 1}
"""Layers of each network."""
SITES = ("features", "quaternions", "scales")


def sites(size: Size) -> Problem:
    """Anchors in voxels of edge 1, all networks at work."""
    count = size[0]
    draw = torch.Generator().manual_seed(count)
    normal = lambda *shape: torch.randn(*shape, generator=draw)
    edge = max(2, round((count / FILLED) ** (1 / 3)))
    cells = torch.randperm(edge**3, generator=draw)[:count]
    corner = torch.stack([cells // edge**2, cells // edge % edge, cells % edge], dim=1)
    centres = corner + 0.05 + 0.9 * torch.rand(count, 3, generator=draw)
    made = support_network.create(CHANNELS, draw, torch.float32)
    shaken = lambda value: value + 0.1 * normal(*value.shape)
    leaves = {
        "features": normal(count, CHANNELS), "quaternions": normal(count, 4),
        "scales": normal(count, 3).exp(), "convolution": shaken(made.convolution),
    }  # fmt: skip
    for name, depth in NETWORKS.items():
        network = getattr(made, name)
        for layer in range(depth):
            leaves[f"{name}.weight{layer}"] = shaken(network.weights[layer])
            leaves[f"{name}.bias{layer}"] = shaken(network.biases[layer])
    given = {"centres": centres, "pairs": pairs(centres, 1.0)}
    return Problem(leaves=leaves, given=given, cotangent=normal(count, CHANNELS))


def _network(leaves: Leaves) -> SupportNetwork:
    networks = {
        name: Mlp(
            weights=tuple(leaves[f"{name}.weight{i}"] for i in range(depth)),
            biases=tuple(leaves[f"{name}.bias{i}"] for i in range(depth)),
        )
        for name, depth in NETWORKS.items()
    }
    return SupportNetwork(convolution=leaves["convolution"], **networks)


def _stored(leaves: Leaves, given: Mapping[str, Any]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    features, quaternions, scales = (leaves[name] for name in SITES)
    return features, given["centres"].to(features), quaternions, scales


def _by_definition(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The reference, with all 27 cells of every site."""
    return support_network.support(_network(leaves), *_stored(leaves, given), 1.0)


def _by_products(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """Torch, with the pairs that exist."""
    features = leaves["features"]
    return supported_by_products(
        _network(leaves), *_stored(leaves, given), given["pairs"], torch.arange(len(features)), "full"
    )  # fmt: skip


def _natively(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The kernel, with the same pairs."""
    near, features = given["pairs"], leaves["features"]
    return native.support(
        _network(leaves), *_stored(leaves, given), (near.sites, near.neighbours, near.ends),
        torch.arange(len(features)),
    )  # fmt: skip


CONSISTENCY = Component(
    name="consistency",
    problem=sites,
    reference=Twin(
        name="reference float64", start=functional(_by_definition), dtype=torch.float64
    ),
    twins=(
        Twin(name="cpu", start=functional(_natively)),
        Twin(name="torch", start=functional(_by_products)),
    ),
    usual="cpu", judged=(500,), tiny=(30,),
    cases=(Case(size=(8_000,), quick=True),),
    label="{0[0]} anchors, about 9 in each one's voxels".format,
)  # fmt: skip
