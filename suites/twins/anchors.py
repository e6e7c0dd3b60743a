"""Decoding of anchors into Gaussians by three small networks: torch against one pass over blocks of anchors."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.kernels import anchors as native
from splatproof.reference.anchors import scaffold
from splatproof.reference.anchors.scaffold import Anchors, Decoder
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.splats import Splats
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

K, FEATURES = 10, 32
"""Gaussians and numbers of an anchor, as in the Scaffold-GS release."""
ANCHORS = ("offsets", "features", "log_scales")
NETWORKS = ("opacity", "shape", "colour")
NUMBERS = 14
"""Decoded for a Gaussian."""
Decode = Callable[..., Splats]


def anchors(size: Size) -> Problem:
    """Anchors whose opacities are far from 0, so that rounding does not decide which Gaussians there are.

    Two of three slots hold one.
    """
    count = size[0]
    draw = torch.Generator().manual_seed(count)
    normal = lambda *shape: torch.randn(*shape, generator=draw)
    decoder = scaffold.create_decoder(FEATURES, K, draw)
    slots = torch.where(torch.arange(K) % 3 > 0, 0.8, -0.8)
    leaves = {
        "offsets": normal(count, K, 3), "features": normal(count, FEATURES),
        "log_scales": normal(count, 6) - 2,
    }  # fmt: skip
    for name in NETWORKS:
        (first, second), biases = getattr(decoder, name).weights, getattr(decoder, name).biases
        open_ = name == "opacity"
        leaves |= {
            f"{name}.weight0": first, f"{name}.bias0": biases[0] + 0.1,
            f"{name}.weight1": 0.05 * second if open_ else second,
            f"{name}.bias1": slots if open_ else biases[1],
        }  # fmt: skip
    given = {"centres": 3 * normal(count, 3), "camera": normal(3)}
    shown = int((slots > 0).sum()) * count
    return Problem(leaves=leaves, given=given, cotangent=normal(shown, NUMBERS))


def decodes(decode: Decode) -> Callable[..., Any]:
    """`start` of a decoding: its Gaussians, the numbers of each side by side."""

    def call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
        like = leaves["features"]
        stored = Anchors(
            centres=given["centres"].to(like), **{name: leaves[name] for name in ANCHORS}
        )
        networks = {
            name: Mlp(
                weights=(leaves[f"{name}.weight0"], leaves[f"{name}.weight1"]),
                biases=(leaves[f"{name}.bias0"], leaves[f"{name}.bias1"]),
            )
            for name in NETWORKS
        }
        splats = decode(stored, Decoder(**networks), given["camera"].to(like))
        assert splats.colours is not None
        parts = [splats.means, splats.quaternions, splats.scales, splats.opacities[:, None]]
        return torch.cat([*parts, splats.colours], dim=1)

    return functional(call)


DECODING = Component(
    name="anchors",
    problem=anchors,
    reference=Twin(
        name="reference float64", start=decodes(scaffold.decode), dtype=torch.float64
    ),
    twins=(
        Twin(name="cpu", start=decodes(native.decode)),
        Twin(name="torch", start=decodes(scaffold.decode)),
    ),
    usual="cpu", judged=(2_000,), tiny=(50,),
    cases=(Case(size=(5_000,), quick=True), Case(size=(15_000,)), Case(size=(60_000,))),
    label="{0[0]} anchors, 10 Gaussians each".format,
)  # fmt: skip
