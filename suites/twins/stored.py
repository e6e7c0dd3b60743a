"""View-dependent colour as our small file gives it back: torch in double against the kernel."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.kernels.stored_harmonics import stored_harmonics
from splatproof.methods.storage.packed.straight_through import (
    harmonic_steps,
    stored_harmonics_torch,
)
from splatproof.reference.compression.quantisers import OPPONENT, Steps
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

STEPS = Steps(position=0.01, log_scale=0.1, opacity=0.1, rotation_bits=8, dc=0.05, harmonics=0.04,
              weights=(-50_686, -2_097, 26, 754, -786, -2_490))  # fmt: skip
"""Their size is that of files of flights; the problem's Gaussians reach all seven classes."""
OFF = 0.4
"""Largest distance of a number from its code, in codes: at a half rounding would decide."""


def harmonics(size: Size, codes_apart: float = 1.0) -> Problem:
    """Coefficients of degree 3, none of them half-way between two codes.

    Args:
        size: Number of Gaussians.
        codes_apart: Half of the codes' standard deviation.
    """
    draw = torch.Generator().manual_seed(size[0])
    log_scales = 3 * torch.randn(size[0], 3, generator=draw) - 4
    logits = 4 * torch.randn(size[0], generator=draw)
    shape = size[0], 15, 3
    codes = torch.randn(shape, generator=draw).mul(2 * codes_apart).round()
    channels = codes + OFF * (2 * torch.rand(shape, generator=draw) - 1)
    step = harmonic_steps(log_scales.double(), logits.double(), STEPS)
    rest = (channels.double() * step) @ torch.from_numpy(OPPONENT)
    return Problem(
        leaves={"rest": rest.float()}, given={"log_scales": log_scales, "logits": logits},
        cotangent=torch.randn(shape, generator=draw),
    )  # fmt: skip


def stores(function: Callable[..., Tensor]) -> Callable[..., Any]:
    """A twin of what is stored.

    Args:
        function: Takes coefficients, scales, opacities and the file's steps.
    """

    def call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
        rest = leaves["rest"]
        return function(rest, given["log_scales"].to(rest), given["logits"].to(rest), STEPS)

    return functional(call)


STORED = Component(
    name="stored harmonics",
    problem=harmonics,
    reference=Twin(
        name="reference float64", start=stores(stored_harmonics_torch), dtype=torch.float64
    ),
    twins=(
        Twin(name="cpu", start=stores(stored_harmonics)),
        Twin(name="torch", start=stores(stored_harmonics_torch)),
    ),
    usual="cpu", judged=(2000,), tiny=(100,),
    cases=(Case(size=(20_000,), quick=True), Case(size=(200_000,))),
    label="{0[0]:,} Gaussians of degree 3".format,
)  # fmt: skip
