"""The native decoding of anchors: twin of splatproof.reference.anchors.scaffold.decode, in float32 on the CPU.

It differs from the reference by rounding only, except for slots whose opacity is within rounding of 0, which either of
the two may leave out. Additions: `index` decodes some of the anchors without copying them, `features` replaces
theirs, and a slot that is left out passes nothing on, whatever its values.
"""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.networks import readable
from splatproof.methods.kernels.rasterizer import plain
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.anchors.scaffold import Anchors, Decoder
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.splats import Splats

LAYERS = 2
"""Layers of each network that the kernels evaluate: one hidden layer."""


def applies(anchors: Anchors, decoder: Decoder, camera_centre: Tensor) -> bool:
    """Whether `decode` takes them: float32 on the CPU, one hidden layer, a camera that is not trained.

    Args:
        anchors: What would be decoded.
        decoder: The networks.
        camera_centre: Where the camera stands.
    """
    tensors = [*vars(anchors).values(), *_tensors(decoder)]
    return (
        readable(tensors)
        and all(len(network.weights) == LAYERS for network in _networks(decoder))
        and not camera_centre.requires_grad
    )


def decode(
    anchors: Anchors,
    decoder: Decoder,
    camera_centre: Float[Tensor, "3"],
    *,
    with_distance: bool = False,
    index: Int[Tensor, " v"] | None = None,
    features: Float[Tensor, "v f"] | None = None,
) -> Splats:
    """Gaussians of the anchors as one camera sees them; slots whose opacity is <= 0 are left out.

    mean = centre + offset * exp(ls[:3]), scale = exp(ls[3:]) * sigmoid(.), colour = sigmoid(.).

    Args:
        anchors: The stored anchors.
        decoder: The three networks, each with one hidden layer.
        camera_centre: Centre of the camera in the world, scene units; it gets no gradient.
        with_distance: Whether the networks also read the distance from the camera to the anchor.
        index: Rows of the anchors to decode, ascending; None: all.
        features: Features that the networks read, one row a decoded anchor; None: the stored ones.

    Returns: Gaussians in the order of their slots; `rows` and `slots` count among all stored anchors.

    Raises: ValueError unless `applies` and the shapes fit together.

    Source: Lu et al. 2024, "Scaffold-GS", Eqs. 5 to 7; one pass forwards and one backwards over blocks of anchors: ours.
    """
    if not applies(anchors, decoder, camera_centre):
        raise ValueError(
            "expected torch.float32 on the CPU, networks of one hidden layer and a camera without "
            "gradient; splatproof.reference.anchors.scaffold.decode takes the rest"
        )
    read = anchors.features if features is None else features
    means, quaternions, scales, opacities, colours, rows, slots = _Decode.apply(
        camera_centre.detach().to(dtype=torch.float32, device="cpu"),
        (with_distance, features is not None), index,
        anchors.centres, anchors.offsets, read, anchors.log_scales, *_tensors(decoder),
    )  # fmt: skip
    return Splats(
        means=means, quaternions=quaternions, scales=scales, opacities=opacities, colours=colours,
        rows=rows, slots=slots, decoded=index,
    )  # fmt: skip


def _networks(decoder: Decoder) -> tuple[Mlp, ...]:
    return decoder.opacity, decoder.shape, decoder.colour


def _tensors(decoder: Decoder) -> list[Tensor]:
    """Weight, bias, weight, bias of each network."""
    return [
        tensor
        for network in _networks(decoder)
        for layer in zip(network.weights, network.biases, strict=True)
        for tensor in layer
    ]


class _Decode(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, camera: Tensor, flags: tuple[bool, bool], index: Tensor | None, *tensors: Tensor
    ):
        centres, offsets, features, log_scales, *networks = [
            t.detach().contiguous() for t in tensors
        ]
        anchors = _ext.Anchors(
            centres, offsets, features, log_scales, plain(index), camera.contiguous(),
            flags[0], flags[1], networks,
        )  # fmt: skip
        use_threads()
        state = _ext.open_anchors(anchors)
        new = centres.new_empty
        means, scales, colours = (new(state.count, 3) for _ in range(3))
        quaternions, opacities = new(state.count, 4), new(state.count)
        rows, slots = (torch.empty(state.count, dtype=torch.int64) for _ in range(2))
        _ext.fill_anchors(
            state, anchors, means, quaternions, scales, opacities, colours, rows, slots
        )
        if any(ctx.needs_input_grad):
            ctx.state, ctx.anchors = state, anchors
            ctx.save_for_backward(quaternions, scales, colours, *tensors)
        ctx.mark_non_differentiable(rows, slots)
        ctx.set_materialize_grads(False)
        return means, quaternions, scales, opacities, colours, rows, slots

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor | None):
        quaternions, scales, colours, *tensors = ctx.saved_tensors
        by_means, by_quaternions, by_scales, by_opacities, by_colours, _, _ = map(
            plain, grad_outputs
        )
        needed = ctx.needs_input_grad[3:]
        centres, offsets, features, log_scales = (
            torch.empty_like(t, memory_format=torch.contiguous_format) if need else None
            for t, need in zip(tensors[:4], needed[:4], strict=True)
        )
        shared = [torch.empty(t.shape) for t in tensors[4:]] if any(needed[4:]) else []
        use_threads()
        _ext.decode_backward(
            ctx.state, ctx.anchors, quaternions, scales, colours, by_means, by_quaternions,
            by_scales, by_opacities, by_colours, centres, offsets, features, log_scales, shared,
        )  # fmt: skip
        networks = shared or [None] * len(tensors[4:])
        return None, None, None, centres, offsets, features, log_scales, *networks
