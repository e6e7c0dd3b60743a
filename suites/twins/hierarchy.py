"""Decoding of moving anchors, layer by layer: torch against one pass over blocks of anchors."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.hdgs.decode import decoded
from splatproof.methods.hdgs.networks import drawn, hierarchy
from splatproof.methods.kernels import hierarchy as native
from splatproof.reference.anchors import motion_hierarchy
from splatproof.reference.anchors.motion_hierarchy import HierarchySettings, MotionAnchors
from splatproof.reference.rasterizer import rotation
from splatproof.reference.types.splats import Splats
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

SIZES = HierarchySettings()
"""The paper's sizes: three layers, two children, twelve Gaussians an anchor."""
TIME = 0.3
SEED = 0
NUMBERS = 14
"""Decoded for a Gaussian."""
ROWS = {"features": SIZES.features, "instances": SIZES.instance, "log_scales": 3, "velocities": 3}
"""What is trained of an anchor, as rows."""
OFFSETS = {"offsets1": SIZES.children, "offsets2": SIZES.gaussians}
Decode = Callable[..., Splats]


def moving(size: Size) -> Problem:
    """Anchors at work in all their parts; residual networks do not start at zero here."""
    count = size[0]
    draw = torch.Generator().manual_seed(count)
    normal = lambda *shape: torch.randn(*shape, generator=draw)
    networks = {
        name: value + 0.1 * normal(*value.shape)
        for name, value in drawn(SIZES, SEED, ice=False).items()
    }
    leaves = {name: 0.3 * normal(count, width) for name, width in ROWS.items()}
    leaves |= {name: normal(count, width, 3) for name, width in OFFSETS.items()}
    leaves |= {"peaks": 0.3 * normal(count), "log_spans": 0.1 * normal(count)}
    given = {"centres": 3 * normal(count, 3), "camera": 3 * normal(3)}
    return Problem(
        leaves=leaves | networks, given=given, cotangent=normal(count * SIZES.gaussians, NUMBERS)
    )


def decodes(decode: Decode) -> Callable[..., Any]:
    """`start` of a decoding: its Gaussians, the numbers of each side by side, quaternions of norm 1."""

    def call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
        like = leaves["features"]
        stored = MotionAnchors(
            centres=given["centres"].to(like), quaternions=like.new_zeros(len(like), 4),
            offsets=tuple(leaves[name] for name in OFFSETS),
            **{name: leaves[name] for name in (*ROWS, "peaks", "log_spans")},
        )  # fmt: skip
        networks = hierarchy(leaves, SIZES.layers)
        splats = decode(stored, networks, SIZES, TIME, given["camera"].to(like))
        assert splats.colours is not None
        quaternions = rotation.normalise(splats.quaternions)
        parts = [splats.means, quaternions, splats.scales, splats.opacities[:, None]]
        return torch.cat([*parts, splats.colours], dim=1)

    return functional(call)


HIERARCHY = Component(
    name="hierarchy",
    problem=moving,
    reference=Twin(
        name="reference float64", start=decodes(motion_hierarchy.decode), dtype=torch.float64
    ),
    twins=(
        Twin(name="cpu", start=decodes(native.decode)),
        Twin(name="torch", start=decodes(decoded)),
    ),
    # A position of 35 that an offset of 3 times a scale of 15 gives is 3.1e-5 off in either twin, 9e-7 of itself.
    max_abs_error=5e-5, usual="cpu", judged=(2_000,), tiny=(50,),
    cases=(Case(size=(8_000,), quick=True), Case(size=(40_000,))),
    label="{0[0]} anchors, 12 Gaussians each".format,
)  # fmt: skip
