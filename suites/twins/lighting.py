"""What dlg-gs adds to anchors: attention between those that are near, and the head that adapts colours."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.dlg_gs.attention import local_attention
from splatproof.methods.dlg_gs.neighbours import neighbours
from splatproof.methods.kernels import attention as native_attention
from splatproof.methods.kernels import colour_head as native_head
from splatproof.reference.anchors import attention as reference
from splatproof.reference.anchors.attention import AttentionWeights
from splatproof.reference.anchors.lighting_appearance import mix_colours
from splatproof.reference.types import mlp
from splatproof.reference.types.mlp import Mlp
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

INPUTS, WIDTH = 28, 28
"""Numbers that attention reads of an anchor, and those of query, key and value, as in method dlg-gs."""
NEAR = 16
"""Anchors within RADIUS of one, on average."""
RADIUS = 1.0
PROJECTIONS = ("query", "key", "value")
GAUSSIANS, HEAD = 6, 32
"""Visible Gaussians of an anchor, and the width of the head's hidden layers."""
FAR = 1e-3
"""How far a hidden unit is kept from its bend, on either side of which rounding decides."""


def near(size: Size) -> Problem:
    """Anchors spread evenly in a cube, none within rounding of another's radius."""
    count = size[0]
    draw = torch.Generator().manual_seed(count)
    edge = (count * 4 / 3 * math.pi * RADIUS**3 / NEAR) ** (1 / 3)
    centres = edge * torch.rand(count, 3, generator=draw)
    weights = reference.create(INPUTS, WIDTH, draw)
    leaves = {"features": torch.randn(count, INPUTS, generator=draw)}
    leaves |= {name: getattr(weights, name) for name in PROJECTIONS}
    return Problem(
        leaves=leaves,
        given={"centres": centres, "lists": neighbours(centres, RADIUS), "weights": weights},
        cotangent=torch.randn(count, WIDTH, generator=draw),
    )


def _projections(leaves: Leaves, given: Mapping[str, Any]) -> AttentionWeights:
    kernels = given["weights"]
    return AttentionWeights(
        anchor_kernel=kernels.anchor_kernel, feature_kernel=kernels.feature_kernel,
        **{name: leaves[name] for name in PROJECTIONS},
    )  # fmt: skip


def _attend_densely(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The definition, over all pairs."""
    features = leaves["features"]
    centres = given["centres"].to(features)
    return reference.local_attention(features, centres, RADIUS, _projections(leaves, given))


def _attend_by_lists(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """Torch, over lists of neighbours."""
    return local_attention(leaves["features"], given["lists"], _projections(leaves, given))


def _attend_natively(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The kernel, over the same lists."""
    query, key, value = (leaves["features"] @ leaves[name] for name in PROJECTIONS)
    rows = torch.arange(len(query))
    return native_attention.attend(given["lists"].native, rows, query, key, value)


ATTENTION = Component(
    name="attention",
    problem=near,
    reference=Twin(
        name="reference float64", start=functional(_attend_densely), dtype=torch.float64
    ),
    twins=(
        Twin(name="cpu", start=functional(_attend_natively)),
        Twin(name="torch", start=functional(_attend_by_lists)),
    ),
    usual="cpu", judged=(1_000,), tiny=(60,),
    cases=(Case(size=(10_000,), quick=True),),
    label="{0[0]} anchors, about 16 near each".format,
)  # fmt: skip


def coloured(size: Size) -> Problem:
    """Gaussians of anchors, and a head none of whose hidden units is within rounding of its bend."""
    count = size[0]
    draw = torch.Generator().manual_seed(count)
    rand = lambda *shape: torch.rand(*shape, generator=draw)
    head = mlp.create((3, HEAD, HEAD, 4), draw)
    owner = torch.arange(count).repeat_interleave(GAUSSIANS)
    leaves = {"colours": rand(len(owner), 3), "of_each": torch.randn(count, HEAD, generator=draw)}
    leaves |= {f"weight{i}": weight for i, weight in enumerate(head.weights)}
    leaves |= {f"bias{i}": 0.3 * rand(len(head.biases[i])) for i in (1, 2)}
    one, two = _hidden(leaves, owner)
    clear = (torch.cat([one, two], dim=1).abs() > FAR).all(dim=1)
    cotangent = torch.randn(len(owner), 3, generator=draw) * clear[:, None]
    return Problem(leaves=leaves, given={"owner": owner}, cotangent=cotangent)


def _hidden(leaves: Leaves, owner: Tensor) -> tuple[Tensor, Tensor]:
    """What goes into the units of the two hidden layers."""
    one = leaves["colours"] @ leaves["weight0"] + leaves["of_each"][owner]
    return one, one.relu() @ leaves["weight1"] + leaves["bias1"]


def _adapt_in_torch(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The head, its first layer made once an anchor, and the mix."""
    _, two = _hidden(leaves, given["owner"])
    out = torch.sigmoid(two.relu() @ leaves["weight2"] + leaves["bias2"])
    return mix_colours(leaves["colours"], out[:, :3], out[:, 3:])


def _adapt_natively(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The kernel."""
    none = torch.zeros_like(leaves["bias1"])  # of_each has the first layer's
    head = Mlp(
        weights=tuple(leaves[f"weight{i}"] for i in range(3)),
        biases=(none, leaves["bias1"], leaves["bias2"]),
    )
    return native_head.adapt(leaves["colours"], leaves["of_each"], given["owner"], head)


COLOUR_HEAD = Component(
    name="colour head",
    problem=coloured,
    reference=Twin(
        name="reference float64", start=functional(_adapt_in_torch), dtype=torch.float64
    ),
    twins=(
        Twin(name="cpu", start=functional(_adapt_natively)),
        Twin(name="torch", start=functional(_adapt_in_torch)),
    ),
    usual="cpu", judged=(1_000,), tiny=(20,),
    cases=(Case(size=(17_000,), quick=True),),
    label="{0[0]} anchors, 6 Gaussians each".format,
)  # fmt: skip
