"""The native colour head of dlg-gs: a network of three layers and the mix, Gaussian by Gaussian, in float32.

It agrees with splatproof.reference.anchors.lighting_appearance.adapt_colours up to rounding, given what the head's first
layer makes of factor and anchor, which is computed once an anchor.
"""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.networks import readable
from splatproof.methods.kernels.rasterizer import plain
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.types.mlp import Mlp

LAYERS = 3
"""Layers of a head that the kernels evaluate."""


def applies(colours: Tensor, of_each: Tensor, head: Mlp) -> bool:
    """Whether `adapt` takes them: float32 on the CPU, three layers.

    Args:
        colours: What would be adapted.
        of_each: What the head's first layer makes of the anchors.
        head: The network.
    """
    tensors = [colours, of_each, *head.weights, *head.biases]
    return len(head.weights) == LAYERS and readable(tensors)


def adapt(
    colours: Float[Tensor, "m 3"],
    of_each: Float[Tensor, "n h"],
    owner: Int[Tensor, " m"],
    head: Mlp,
) -> Float[Tensor, "m 3"]:
    """c~ = beta c + (1 - beta) alpha, (alpha, beta) = sigmoid of the head.

    Args:
        colours: Colours c of the Gaussians, in [0, 1].
        of_each: What the head's first layer makes of each anchor and the view, its bias included.
        owner: Anchor of each Gaussian, ascending.
        head: Three layers; the first three rows of the first weight read the colour, the rest is not
            read; 4 outputs: alpha 3, beta 1 for all channels.

    Raises: ValueError unless `applies` and the shapes fit together.

    Source: DLG-GS, Eqs. 12 and 13.
    """
    if not applies(colours, of_each, head):
        raise ValueError("expected torch.float32 on the CPU and a head of three layers")
    first, second, third = head.weights
    return _Adapt.apply(
        owner, colours, of_each, first[:3], second, head.biases[1], third, head.biases[2]
    )


class _Adapt(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, owner: Tensor, *tensors: Tensor):
        colours, of_each, of_colour, second, second_bias, third, third_bias = (
            t.detach().contiguous() for t in tensors
        )
        head = _ext.ColourHead(
            colours, of_each, owner.contiguous(), of_colour, second, second_bias, third, third_bias
        )
        adapted = torch.empty_like(colours)
        use_threads()
        _ext.adapt_colours(head, adapted)
        ctx.head = head
        ctx.save_for_backward(*tensors)
        return adapted

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        of = plain(grad_outputs[0])
        assert of is not None
        by_colours, by_each, by_of_colour, by_second, by_second_bias, by_third, by_third_bias = (
            torch.empty(t.shape) for t in ctx.saved_tensors
        )
        use_threads()
        _ext.adapt_colours_backward(
            ctx.head, of, by_colours, by_each, by_of_colour, by_second, by_second_bias, by_third,
            by_third_bias,
        )  # fmt: skip
        return (
            None, by_colours, by_each, by_of_colour, by_second, by_second_bias, by_third,
            by_third_bias,
        )  # fmt: skip
