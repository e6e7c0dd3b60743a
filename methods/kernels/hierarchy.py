"""The native decoding of moving anchors: twin of splatproof.reference.anchors.motion_hierarchy.decode, in float32.

It differs from the reference by rounding only, and leaves quaternions of any norm. Additions: `index` decodes some of
the anchors without copying them, `features` replaces theirs, and `visible` says of which an image may show anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.networks import readable
from splatproof.methods.kernels.rasterizer import plain
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.anchors.motion_hierarchy import (
    HierarchyNetworks,
    HierarchySettings,
    MotionAnchors,
)
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.splats import Splats

DEPTH = 2
"""Layers of each network that the kernels evaluate: one hidden layer."""
MOST_LAYERS = 8
"""Largest N that the kernels have room for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pyramid:
    """What an image may show, in the anchors' frame and unit: what lies before it and between its four sides."""

    pose: Float[Tensor, "3 4"]
    """From the anchors' frame into the camera's, float32."""
    near: float
    """Depth from which anything is drawn."""
    sides: Float[Tensor, "4 3"]
    """Unit normals of planes through the camera in its frame, inwards, float32."""
    sigmas: float
    """Scales of a Gaussian within which it is drawn."""
    blur: float
    """What is drawn of a Gaussian beyond that, as a share of its distance."""


def applies(
    anchors: MotionAnchors, networks: HierarchyNetworks, camera_centre: Tensor | None = None
) -> bool:
    """Whether the kernels take them: float32 on the CPU, one hidden layer, a camera that is not trained.

    Args:
        anchors: What would be decoded.
        networks: The networks.
        camera_centre: Where the camera stands, if anything is seen.
    """
    tensors = [*_stored(anchors), *_tensors(networks)]
    return (
        readable(tensors)
        and all(len(network.weights) == DEPTH for network in _networks(networks))
        and len(anchors.offsets) < MOST_LAYERS
        and not (camera_centre is not None and camera_centre.requires_grad)
    )


def decode(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    settings: HierarchySettings,
    time: float,
    camera_centre: Float[Tensor, "3"],
    *,
    index: Int[Tensor, " v"] | None = None,
    features: Float[Tensor, "v f"] | None = None,
    unit: float = 1.0,
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Splats:
    """Gaussians at time t, as `motion_hierarchy.decode` says; quaternions are left of any norm.

    Args:
        anchors: The stored anchors.
        networks: From `create_networks` with the same settings.
        settings: Sizes; the offsets must fit them.
        time: t, in the unit of the peaks and of the period.
        camera_centre: Camera centre in the anchors' frame; it gets no gradient.
        index: Rows of the anchors to decode, ascending; None: all.
        features: Features that layer 0 starts from, one row a decoded anchor; None: the stored ones.
        unit: What positions and scales are multiplied by once they are decoded.
        middle: What is then added to the positions.

    Returns: K Gaussians a decoded anchor, in its order; `rows` and `slots` count among all stored anchors.

    Raises: ValueError unless `applies` and the shapes fit together.

    Source: HDGS, Eqs. 1 to 6; one pass forwards and one backwards over blocks of anchors: ours.
    """
    if not applies(anchors, networks, camera_centre):
        raise ValueError(
            "expected torch.float32 on the CPU, networks of one hidden layer, few layers and a camera "
            "without gradient; splatproof.reference.anchors.motion_hierarchy.decode takes the rest"
        )
    stored = _stored(anchors)
    if features is not None:
        stored[0] = features
    means, quaternions, scales, opacities, colours, rows, slots = _Decode.apply(
        _Facts(settings, time, camera_centre, index, features is not None, unit, middle),
        len(stored),
        *stored, *_tensors(networks),
    )  # fmt: skip
    return Splats(
        means=means, quaternions=quaternions, scales=scales, opacities=opacities, colours=colours,
        rows=rows, slots=slots, decoded=index,
    )  # fmt: skip


@torch.no_grad()
def visible(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    settings: HierarchySettings,
    time: float,
    pyramid: Pyramid,
    *,
    index: Int[Tensor, " v"] | None = None,
    drift: Float[Tensor, "v 3"] | None = None,
) -> Bool[Tensor, " v"]:
    """Whether an image may show a Gaussian of each anchor: of one that is not True it shows none.

    Args:
        anchors: The stored anchors.
        networks: Those of positions and scales are run.
        settings: Sizes; the offsets must fit them.
        time: In the unit of the peaks.
        pyramid: What the image opens.
        index: Rows of the anchors that are asked about, ascending; None: all.
        drift: What is added to the positions of what each decodes to; None: nothing.

    Raises: ValueError if the shapes do not fit together.
    """
    facts = _Facts(settings, time, anchors.centres.new_zeros(3), index, False)
    native = facts.arrays(_stored(anchors), _tensors(networks))
    out = torch.empty(len(anchors.centres) if index is None else len(index), dtype=torch.bool)
    use_threads()
    _ext.visible_anchors(
        native, pyramid.pose.contiguous(), pyramid.sides.contiguous(), pyramid.near,
        pyramid.sigmas, pyramid.blur, plain(drift), out,
    )  # fmt: skip
    return out


def _stored(anchors: MotionAnchors) -> list[Tensor]:
    """What the kernels read, in their order."""
    return [
        anchors.features, anchors.instances, anchors.centres, anchors.velocities,
        anchors.log_scales, anchors.peaks, anchors.log_spans, *anchors.offsets,
    ]  # fmt: skip


def _networks(networks: HierarchyNetworks) -> list[Mlp]:
    layers = [net for one in networks.layers for net in (one.position, one.scale, one.feature)]
    return [
        *layers, networks.leaf_position, networks.colour, networks.opacity, networks.shape,
    ]  # fmt: skip


def _tensors(networks: HierarchyNetworks) -> list[Tensor]:
    """Weight, bias, weight, bias of each network."""
    return [
        tensor
        for network in _networks(networks)
        for layer in zip(network.weights, network.biases, strict=True)
        for tensor in layer
    ]


class _Facts:
    """What a decoding is told beside the tensors that get gradients."""

    def __init__(
        self,
        settings: HierarchySettings,
        time: float,
        camera: Tensor,
        index: Tensor | None,
        own: bool,
        unit: float = 1.0,
        middle: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.settings, self.time, self.index, self.own = settings, time, index, own
        self.unit, self.middle = unit, torch.tensor(middle, dtype=torch.float32)
        self.camera = camera.detach().to(dtype=torch.float32, device="cpu").contiguous()

    def arrays(self, stored: Sequence[Tensor], networks: Sequence[Tensor]) -> _ext.MovingAnchors:
        """The tensors as the kernels take them."""
        features, instances, centres, velocities, log_scales, peaks, log_spans, *offsets = [
            t.detach().contiguous() for t in stored
        ]
        return _ext.MovingAnchors(
            features, instances, centres, velocities, log_scales, peaks, log_spans, offsets,
            plain(self.index), self.camera, self.own, self.settings.children,
            self.settings.gaussians, self.settings.period, self.time, self.unit, self.middle,
            [t.detach().contiguous() for t in networks],
        )  # fmt: skip


class _Decode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, facts: _Facts, count: int, *tensors: Tensor):
        arrays = facts.arrays(tensors[:count], tensors[count:])
        new = tensors[0].new_empty
        chosen = len(tensors[2]) if facts.index is None else len(facts.index)
        n = chosen * facts.settings.gaussians
        means, scales, colours = (new(n, 3) for _ in range(3))
        quaternions, opacities = new(n, 4), new(n)
        rows, slots = (torch.empty(n, dtype=torch.int64) for _ in range(2))
        use_threads()
        _ext.decode_moving_anchors(
            arrays, means, quaternions, scales, opacities, colours, rows, slots
        )
        if any(ctx.needs_input_grad):
            ctx.arrays, ctx.count = arrays, count
            ctx.save_for_backward(*tensors)
        ctx.mark_non_differentiable(rows, slots)
        ctx.set_materialize_grads(False)
        return means, quaternions, scales, opacities, colours, rows, slots

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor | None):
        tensors = ctx.saved_tensors
        needed = ctx.needs_input_grad[2:]
        stored: list[Tensor | None] = [
            torch.empty_like(t, memory_format=torch.contiguous_format) if need else None
            for t, need in zip(tensors[: ctx.count], needed[: ctx.count], strict=True)
        ]
        trained = any(needed[ctx.count :])
        shared = [torch.empty(t.shape) for t in tensors[ctx.count :]] if trained else []
        use_threads()
        means, quaternions, scales, opacities, colours, _, _ = map(plain, grad_outputs)
        _ext.moving_anchors_backward(
            ctx.arrays, means, quaternions, scales, opacities, colours, stored, shared
        )
        return None, None, *stored, *(shared or [None] * len(tensors[ctx.count :]))
