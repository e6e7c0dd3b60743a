"""Where the Gaussians of anchors are, and how large at most: the part of decoding that needs no camera."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.anchors.motion_hierarchy import (
    HierarchyNetworks,
    HierarchySettings,
    MotionAnchors,
    code,
)
from splatproof.reference.types import mlp


def placed(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    sizes: HierarchySettings,
    times: Float[Tensor, " n"],
) -> tuple[Float[Tensor, "n k 3"], Float[Tensor, "n k"]]:
    """Means of all K Gaussians of each anchor, and bounds of their standard deviations.

    Twin of `motion_hierarchy.decode` for positions alone, at a time for each anchor.

    Args:
        anchors: The stored layer 0 and offsets.
        networks: Those of positions and scales are run.
        sizes: Of the hierarchy.
        times: In the unit of the peaks; at its own peak an anchor stands at its centre.

    Returns: Means in the anchors' unit; the largest of an anchor's three base scales, which its
        Gaussians' are below.
    """
    period = sizes.period
    swing = period / (2 * math.pi) * torch.sin(2 * math.pi * (times - anchors.peaks) / period)
    at = anchors.centres + swing[:, None] * anchors.velocities
    told = torch.cat([anchors.instances, code(times[:, None])], dim=1)
    scales = anchors.log_scales
    for layer, offsets in zip(networks.layers, anchors.offsets[:-1], strict=True):
        inputs, k = _inputs(told, at), sizes.children
        steps = offsets.reshape(len(at), k, 3) * scales.exp()[:, None]
        moved = mlp.evaluate(layer.position, inputs).reshape(-1, k, 3)
        at = (at[:, None] + moved + steps).reshape(-1, 3)
        grown = mlp.evaluate(layer.scale, inputs).reshape(-1, k, 3)
        scales = (scales[:, None] + grown).reshape(-1, 3)
    count = sizes.gaussians // sizes.leaves
    base = scales.exp()
    moved = mlp.evaluate(networks.leaf_position, _inputs(told, at)).reshape(-1, count, 3)
    steps = anchors.offsets[-1].reshape(len(at), count, 3) * base[:, None]
    means = at[:, None] + steps + moved
    most = base.amax(dim=1, keepdim=True).expand(-1, count)
    shape = (len(times), sizes.gaussians)
    return means.reshape(*shape, 3), most.reshape(shape)


def _inputs(told: Float[Tensor, "n e"], at: Float[Tensor, "m 3"]) -> Float[Tensor, "m i"]:
    """What residual networks read, h, emb(mu), emb(t), where h and emb(t) are those of layer 0."""
    told = told.repeat_interleave(len(at) // max(1, len(told)), dim=0)
    return torch.cat([told[:, : told.shape[1] - 9], code(at), told[:, told.shape[1] - 9 :]], dim=1)
