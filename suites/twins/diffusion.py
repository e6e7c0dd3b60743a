"""Diffusion between the edges of a photo: the reference in torch against the kernel."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.kernels import diffusion as native
from splatproof.reference.layered_memory import edge_diffusion
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

SWEEPS, CONTRAST = 60, 0.1
"""As the denoiser has them by default."""


def photo(size: Size) -> Problem:
    """A noisy photo of two surfaces, and depth logits around 0."""
    width, height = size
    draw = torch.Generator().manual_seed(width)
    image = 0.05 * torch.randn(height, width, 3, generator=draw) + 0.3
    image[:, width // 2 :] += 0.5
    values, cotangent = (torch.randn(height, width, generator=draw) for _ in range(2))
    return Problem(leaves={"values": values}, given={"image": image}, cotangent=cotangent)


def diffuses(function: Callable[..., Tensor]) -> Callable[..., Any]:
    """A twin of the sweeps; weights are made from the photo besides.

    Args:
        function: Takes values, both weights and the number of sweeps.
    """

    def call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
        values, image = leaves["values"], given["image"].to(leaves["values"].dtype)
        return function(values, *edge_diffusion.exchange_weights(image, CONTRAST), SWEEPS)

    return functional(call)


DIFFUSION = Component(
    name="edge diffusion",
    problem=photo,
    reference=Twin(
        name="reference float64", start=diffuses(edge_diffusion.diffused), dtype=torch.float64
    ),
    twins=(
        Twin(name="cpu", start=diffuses(native.diffused)),
        Twin(name="torch", start=diffuses(edge_diffusion.diffused)),
    ),
    usual="cpu", judged=(60, 45), tiny=(20, 15),
    cases=(Case(size=(240, 160), quick=True), Case(size=(480, 320))),
    label="{0[0]} x {0[1]} pixels, 60 sweeps".format,
)  # fmt: skip
