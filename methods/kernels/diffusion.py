"""The native diffusion between the edges of an image, in float32.

It agrees with splatproof.reference.layered_memory.edge_diffusion.diffused up to rounding; weights get no gradient.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.rasterizer import plain


def diffused(
    values: Float[Tensor, "h w"],
    across: Float[Tensor, "h w-1"],
    down: Float[Tensor, "h-1 w"],
    sweeps: int,
) -> Float[Tensor, "h w"]:
    """Sweeps of exchange with the four neighbours, in one thread. Differentiable by the values.

    Args:
        values: What is smoothed; at least one pixel.
        across: Weight, 0 to 1, of the exchange with the pixel to the right.
        down: Weight, 0 to 1, of the exchange with the pixel below.
        sweeps: Number of sweeps, >= 0.

    Raises: ValueError unless everything is float32 on the CPU, and the shapes fit together.

    Source: as of its reference; that the gradient is the same diffusion: ours.
    """
    if any(t.dtype != torch.float32 or t.device.type != "cpu" for t in (values, across, down)):
        raise ValueError("expected torch.float32 on the CPU")
    return _Diffuse.apply(values, across, down, sweeps)


class _Diffuse(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, across: Tensor, down: Tensor, sweeps: int):
        weights = (across.detach().contiguous(), down.detach().contiguous())
        ctx.weights, ctx.sweeps = weights, sweeps
        return _diffused(values, weights, sweeps)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        # each sweep is I + L / 4 with L symmetric, so the map is its own transpose
        return _diffused(grad_outputs[0], ctx.weights, ctx.sweeps), None, None, None


def _diffused(values: Tensor, weights: tuple[Tensor, Tensor], sweeps: int) -> Tensor:
    held = plain(values)
    assert held is not None
    smoothed = torch.empty_like(held)
    across, down = weights
    _ext.diffuse(held, across, down, sweeps, smoothed)
    return smoothed
