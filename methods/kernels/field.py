"""The native field: features of four grids and a network of one hidden layer, place by place, in float32.

It agrees with splatproof.reference.layered_memory.coordinate_field.evaluate over the unit box up to rounding; places
get no gradient.
"""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.rasterizer import plain
from splatproof.methods.kernels.threads import use_threads

GRIDS, CHANNELS = 4, 4
"""Grids of a field that the kernels evaluate, and features of each at a sample."""
MOST_OUTPUTS = 16
"""Most numbers at a place."""


def evaluate(
    places: Float[Tensor, "n 3"],
    grids: Sequence[Tensor],
    network: Sequence[Tensor],
) -> Float[Tensor, "n m"]:
    """Values at places of the unit box: trilinear features of all grids, then a network with SiLU.

    Differentiable by grids and network. The same bits for any number of threads.

    Args:
        places: Position in the box, 0 to 1 on each axis; outside, the border's features hold.
        grids: Four grids s x s x s x 4 of four channels; z is the first, x the third axis.
        network: Weight and bias of the hidden layer (16 inputs), weight and bias of the outputs (at most
            16).

    Raises: ValueError unless everything is float32 on the CPU, and the shapes fit together.

    Source: as of its reference; fused gather and network, gradients in a fixed order: ours.
    """
    tensors = (places, *grids, *network)
    if any(t.dtype != torch.float32 or t.device.type != "cpu" for t in tensors):
        raise ValueError("expected torch.float32 on the CPU")
    if len(grids) != GRIDS or len(network) != 4:
        raise ValueError(
            f"{len(grids)} grids and {len(network)} tensors of a network, expected 4 and 4"
        )
    return _Evaluate.apply(places, *grids, *network)


class _Evaluate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, places: Tensor, *tensors: Tensor):
        held = [t.detach().contiguous() for t in tensors]
        grids, network = held[:GRIDS], held[GRIDS:]
        field = _ext.Field(places.detach().contiguous(), grids, *network)
        features = torch.empty(len(places), GRIDS * CHANNELS)
        values = torch.empty(len(places), network[2].shape[1])
        use_threads()
        _ext.evaluate_field(field, features, values)
        ctx.field = field
        ctx.shapes = [t.shape for t in tensors]
        ctx.save_for_backward(features)
        return values

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        of = plain(grad_outputs[0])
        assert of is not None
        (features,) = ctx.saved_tensors
        new = [torch.empty(shape) for shape in ctx.shapes]
        use_threads()
        _ext.evaluate_field_backward(ctx.field, features, of, new[:GRIDS], *new[GRIDS:])
        return None, *new
