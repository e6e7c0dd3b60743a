"""The native consistency step: twin of splatproof.methods.hdgs.consistency.supported, in float32 on the CPU.

It differs from it by rounding only; where two scales are equal, gradients by them may be shared out otherwise.
"""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.networks import readable
from splatproof.methods.kernels.rasterizer import plain
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.anchors.support_network import SupportNetwork

SITES = 4
"""Tensors of the sites: features, centres, quaternions and scales."""


def applies(network: SupportNetwork, *sites: Tensor) -> bool:
    """Whether `support` takes them: float32 on the CPU, networks as `support_network.create` makes them.

    Args:
        network: Parameters of the step.
        sites: Features, centres, quaternions and scales; the centres get no gradient.
    """
    depths = [len(net.weights) for net in (network.modulation, network.gate, network.residual)]
    tensors = [*sites, *_parameters(network)]
    return readable(tensors) and depths == [2, 2, 1] and not sites[1].requires_grad


def support(
    network: SupportNetwork,
    features: Float[Tensor, "n c"],
    centres: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    pairs: tuple[Int[Tensor, " p"], Int[Tensor, " p"], Sequence[int]],
    seen: Int[Tensor, " v"],
    *,
    modulated: bool = True,
    gated: bool = True,
) -> Float[Tensor, "v c"]:
    """Features of some sites after the step: f + g(f_mod) Linear(f_mod).

    Args:
        network: Parameters of the step.
        features: Features of all sites.
        centres: Positions of all sites.
        quaternions: Orientation (w, x, y, z) of each base covariance, any norm.
        scales: Standard deviations of the base covariance, > 0.
        pairs: Who receives, who gives, and where the pairs of each kernel cell end; those whose receiving site is
            not seen count for nothing.
        seen: Rows of the sites whose features are asked for.
        modulated: Whether direction and shape weigh what is given.
        gated: Whether the gate weighs what is added.

    Raises: ValueError unless `applies` and the shapes fit together.

    Source: HDGS, Eqs. 7 and 8.
    """
    if not applies(network, features, centres, quaternions, scales):
        raise ValueError(
            "expected torch.float32 on the CPU, networks of support_network.create and centres without "
            "gradient; splatproof.methods.hdgs.consistency.supported takes the rest"
        )
    return _Support.apply(
        (*pairs, seen, modulated, gated), features, centres, quaternions, scales,
        *_parameters(network),
    )  # fmt: skip


def _parameters(network: SupportNetwork) -> list[Tensor]:
    """Convolution, then weight and bias of each layer of modulation, gate and residual."""
    return [network.convolution] + [
        tensor
        for net in (network.modulation, network.gate, network.residual)
        for layer in zip(net.weights, net.biases, strict=True)
        for tensor in layer
    ]


class _Support(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, facts: tuple, *tensors: Tensor):
        receive, give, ends, seen, modulated, gated = facts
        features, centres, quaternions, scales, *parameters = [
            t.detach().contiguous() for t in tensors
        ]
        native = _ext.Sites(
            features, centres, quaternions, scales, receive.contiguous(), give.contiguous(),
            list(ends), seen.contiguous(), parameters, modulated, gated,
        )  # fmt: skip
        out, mixed = (features.new_empty(len(seen), features.shape[1]) for _ in range(2))
        use_threads()
        _ext.support(native, out, mixed)
        if any(ctx.needs_input_grad):
            ctx.native, ctx.mixed = native, mixed
            ctx.save_for_backward(*tensors)
        return out

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        tensors = ctx.saved_tensors
        needed = ctx.needs_input_grad[1:]
        new = lambda i: torch.empty(tensors[i].shape) if needed[i] else None
        features, quaternions, scales = new(0), new(2), new(3)
        parameters = [torch.empty(t.shape) for t in tensors[SITES:]]
        use_threads()
        _ext.support_backward(
            ctx.native, ctx.mixed, plain(grad_outputs[0]), features, quaternions, scales, parameters
        )
        return None, features, None, quaternions, scales, *parameters
