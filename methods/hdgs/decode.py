"""Decoding of moving anchors by the kernels, or with few, wide matrix products: twins of the reference's hierarchy."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.methods.kernels import hierarchy as native
from splatproof.reference.anchors.motion_hierarchy import (
    HierarchyNetworks,
    HierarchySettings,
    MotionAnchors,
    code,
)
from splatproof.reference.anchors.scaffold import view_code
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.splats import Splats


@dataclass(frozen=True, kw_only=True, eq=False)
class Placed:
    """The last anchors, and where their Gaussians stand."""

    at: Float[Tensor, "a 3"]
    features: Float[Tensor, "a f"] | None
    base: Float[Tensor, "a 3"]
    """Scales of the last anchors: their Gaussians' are below."""
    away: Float[Tensor, "a c 3"]
    """Offset of each of an anchor's Gaussians from it."""


@torch.no_grad()
def visible(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    sizes: HierarchySettings,
    time: float,
    index: Int[Tensor, " v"],
    pyramid: native.Pyramid,
    drift: Float[Tensor, "v 3"] | None = None,
) -> Bool[Tensor, " v"]:
    """Whether an image may show a Gaussian of each of some anchors, without decoding them.

    An anchor counts if a ball around one of its last descendants, which holds all that one's Gaussians
    with all their pixels, meets the pyramid.

    Args:
        anchors: All stored anchors.
        networks: Those of positions and scales are run.
        sizes: Sizes of the hierarchy.
        time: In the unit of the peaks.
        index: Rows of those that are asked about, ascending.
        pyramid: What the image opens.
        drift: What is added to the positions of what each decodes to; None: nothing.
    """
    if native.applies(anchors, networks):
        return native.visible(anchors, networks, sizes, time, pyramid, index=index, drift=drift)
    chosen = some(anchors, index)
    last = placed(chosen, networks, sizes, torch.full_like(chosen.peaks, time))
    away = last.away.square().sum(dim=2).amax(dim=1).sqrt()
    at = last.at if drift is None else last.at + drift.repeat_interleave(sizes.leaves, dim=0)
    pose = pyramid.pose.to(at)
    local = at @ pose[:, :3].T + pose[:, 3]
    depth = local[:, 2]
    radius = away + pyramid.sigmas * last.base.amax(dim=1) + pyramid.blur * (depth.abs() + away)
    seen = depth + away > pyramid.near
    seen &= (local @ pyramid.sides.to(at).T > -radius[:, None]).all(dim=1)
    return seen.reshape(len(index), sizes.leaves).any(dim=1)


def decode_some(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    sizes: HierarchySettings,
    time: float,
    camera_centre: Float[Tensor, "3"],
    index: Int[Tensor, " v"],
    *,
    features: Float[Tensor, "v f"] | None = None,
    unit: float = 1.0,
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Splats:
    """What some of the stored anchors decode to; rows and slots count among all.

    Args:
        anchors: All stored anchors.
        networks: Networks of the same sizes.
        sizes: Sizes of the hierarchy.
        time: In the unit of the peaks.
        camera_centre: In the anchors' frame.
        index: Rows of the anchors that are decoded, ascending.
        features: Features that layer 0 starts from, one row a decoded anchor; None: the stored ones.
        unit: What positions and scales are multiplied by once they are decoded.
        middle: What is then added to the positions.
    """
    if native.applies(anchors, networks, camera_centre):
        return native.decode(
            anchors, networks, sizes, time, camera_centre, index=index, features=features,
            unit=unit, middle=middle,
        )  # fmt: skip
    chosen = some(anchors, index)
    if features is not None:
        chosen = replace(chosen, features=features)
    k = sizes.gaussians
    places = torch.arange(k, device=index.device)
    splats = decoded(chosen, networks, sizes, time, camera_centre)
    return replace(
        splats, decoded=index, scales=splats.scales * unit,
        means=splats.means * unit + splats.means.new_tensor(middle),
        rows=index.repeat_interleave(k), slots=(index[:, None] * k + places).reshape(-1),
    )  # fmt: skip


def some(anchors: MotionAnchors, index: Int[Tensor, " v"]) -> MotionAnchors:
    """Copies of some of the anchors.

    Args:
        anchors: All of them.
        index: Rows of those that are wanted.
    """
    parts = {
        name: value.index_select(0, index)
        for name, value in vars(anchors).items()
        if isinstance(value, Tensor)
    }
    return MotionAnchors(
        **parts, offsets=tuple(value.index_select(0, index) for value in anchors.offsets)
    )


def placed(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    sizes: HierarchySettings,
    times: Float[Tensor, " n"],
    *,
    features: bool = False,
) -> Placed:
    """Positions of everything that descends from some anchors, at a time for each.

    Args:
        anchors: The stored layer 0 and offsets.
        networks: Those of positions and scales are run, and those of features where asked for.
        sizes: Sizes of the hierarchy.
        times: In the unit of the peaks; at its own peak an anchor stands at its centre.
        features: Whether the last anchors' features are wanted.

    Source: HDGS, Eqs. 1 to 4.
    """
    period, k = sizes.period, sizes.children
    swing = period / (2 * math.pi) * torch.sin(2 * math.pi * (times - anchors.peaks) / period)
    at = anchors.centres + swing[:, None] * anchors.velocities
    scales = anchors.log_scales
    held = anchors.features if features else None
    told = [anchors.instances, code(times[:, None])]
    for layer, offsets in zip(networks.layers, anchors.offsets[:-1], strict=True):
        nets = [layer.position, layer.scale, *([layer.feature] if features else [])]
        change = together(nets, torch.cat([told[0], code(at), told[1]], dim=1))
        steps = offsets.reshape(len(at), k, 3) * scales.exp()[:, None]
        at = (at[:, None] + change[0].reshape(-1, k, 3) + steps).reshape(-1, 3)
        scales = (scales[:, None] + change[1].reshape(-1, k, 3)).reshape(-1, 3)
        if held is not None:
            width = held.shape[1]
            held = (held[:, None] + change[2].reshape(-1, k, width)).reshape(-1, width)
        told = [value.repeat_interleave(k, dim=0) for value in told]
    count, base = sizes.gaussians // sizes.leaves, scales.exp()
    (moved,) = together([networks.leaf_position], torch.cat([told[0], code(at), told[1]], dim=1))
    away = anchors.offsets[-1].reshape(-1, count, 3) * base[:, None] + moved.reshape(-1, count, 3)
    return Placed(at=at, features=held, base=base, away=away)


def decoded(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    sizes: HierarchySettings,
    time: float,
    camera_centre: Float[Tensor, "3"],
) -> Splats:
    """Gaussians at a time: twin of `motion_hierarchy.decode`; quaternions are left of any norm.

    Args:
        anchors: The stored layer 0 and offsets.
        networks: Networks of the same sizes.
        sizes: Sizes of the hierarchy.
        time: In the unit of the peaks.
        camera_centre: In the anchors' frame.

    Source: HDGS, Eqs. 1 to 6.
    """
    times = torch.full_like(anchors.peaks, time)
    last = placed(anchors, networks, sizes, times, features=True)
    assert last.features is not None
    direction, distance = view_code(last.at, camera_centre)
    seen = torch.cat([last.features, distance, direction], dim=1)
    colour, opacity, shape = together([networks.colour, networks.opacity, networks.shape], seen)
    count = sizes.gaussians // sizes.leaves
    grown, turned = shape.reshape(-1, count, 7).split([3, 4], dim=2)
    alive = torch.exp(-0.5 * ((time - anchors.peaks) * torch.exp(-anchors.log_spans)).square())
    opacities = torch.sigmoid(opacity).reshape(len(alive), sizes.gaussians) * alive[:, None]
    return Splats(
        means=(last.at[:, None] + last.away).reshape(-1, 3),
        quaternions=turned.reshape(-1, 4),
        scales=(last.base[:, None] * torch.sigmoid(grown)).reshape(-1, 3),
        opacities=opacities.reshape(-1),
        colours=torch.sigmoid(colour).reshape(-1, 3),
    )


def together(networks: list[Mlp], inputs: Float[Tensor, "n a"]) -> list[Float[Tensor, "n _"]]:
    """Outputs of networks of one hidden layer that read the same: one product for all hidden layers.

    Args:
        networks: Networks of two weight matrices each, and one hidden width.
        inputs: One row a sample.
    """
    weight = torch.cat([network.weights[0] for network in networks], dim=1)
    bias = torch.cat([network.biases[0] for network in networks])
    hidden = torch.addmm(bias, inputs, weight).relu()
    parts = hidden.split([network.weights[0].shape[1] for network in networks], dim=1)
    return [
        torch.addmm(network.biases[1], part, network.weights[1])
        for network, part in zip(networks, parts, strict=True)
    ]
