"""Ghost Gaussians: the neighbours' primitives around a block that occlude but do not train."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatproof.reference.partition.boxes import Box, bounds, inside, widen
from splatproof.reference.rasterizer import compositing
from splatproof.reference.types.gaussians import Gaussians

RIM = 0.2
"""alpha of DPGS, Eq. 7: the auxiliary box is longer than the core box by this share of each axis."""


def block_boxes(
    points: Float[Tensor, "n 3"],
    labels: Int64[Tensor, " n"],
    block: int,
    *,
    rim: float = RIM,
) -> tuple[Box, Box]:
    """Core box (bounds of the points the block owns) and auxiliary box (core widened by `rim`).

    Args:
        points: Points of the whole scene, scene units.
        labels: Block that owns each point.
        block: Number of the block whose boxes are wanted.
        rim: alpha >= 0: the auxiliary box is longer by this share of each axis.

    Raises: DataError for a block that owns nothing.

    Source: DPGS, Sec. 3.3, Eq. 7.
    """
    core = bounds(points[labels == block])
    return core, widen(core, rim)


def ghosts(
    points: Float[Tensor, "n 3"], labels: Int64[Tensor, " n"], block: int, auxiliary: Box
) -> Bool[Tensor, " n"]:
    """Points inside the block's auxiliary box that another block owns.

    The paper writes Points(aux) \\ Points(core) for boxes; core boxes of blocks with ragged borders
    overlap, so ownership decides here: else a neighbour's point inside the core box would train in
    two blocks.

    Args:
        points: Points of the whole scene, scene units.
        labels: Block that owns each point.
        block: Number of the block that sees the ghosts.
        auxiliary: The block's auxiliary box, from `block_boxes`.

    Source: DPGS, Sec. 3.3 (auxiliary anchors); by ownership: ours (spec: ODBP, item 5).
    """
    return inside(auxiliary, points) & (labels != block)


def freeze(gaussians: Gaussians, ghost: Bool[Tensor, " n"], *, dual: bool = False) -> Gaussians:
    """The same Gaussians, with no gradient to the ghosts' parameters.

    Ghosts must also be left out of densification, splitting and pruning: `ghost` is the mask.

    Args:
        gaussians: Core and ghost Gaussians of one block.
        ghost: Which of them are ghosts.
        dual: Let the ghosts' opacity and colour follow; means, scales and rotations stay frozen.

    Source: DPGS, Sec. 3.3 (dual-mode update); all frozen by default: ours.
    """

    def stop(values: Tensor) -> Tensor:
        rows = ghost.reshape(-1, *[1] * (values.dim() - 1))
        return torch.where(rows, values.detach(), values)

    frozen = replace(
        gaussians, means=stop(gaussians.means), quaternions=stop(gaussians.quaternions),
        log_scales=stop(gaussians.log_scales),
    )  # fmt: skip
    if dual:
        return frozen
    return replace(frozen, opacity_logits=stop(gaussians.opacity_logits), sh=stop(gaussians.sh))


def joint_composite(
    core_alpha: Float[Tensor, "p n"],
    core_depth: Float[Tensor, " n"],
    core_colour: Float[Tensor, "n c"],
    ghost_alpha: Float[Tensor, "p m"],
    ghost_depth: Float[Tensor, " m"],
    ghost_colour: Float[Tensor, "m c"],
) -> Float[Tensor, "p c"]:
    """One depth-ordered composite of core and ghosts: C = sum_i c_i a_i prod_{j<i} (1 - a_j).

    Eq. 8 writes a sum over the core plus a sum over the ghosts; i and j run over both together
    here. Two separate composites would not occlude each other and add up to more than full opacity.

    Args:
        core_alpha: Opacity of each core Gaussian at each pixel, in [0, 1].
        core_depth: Camera-space z of the core Gaussians; where z is equal, the core comes first.
        core_colour: Colour of each core Gaussian.
        ghost_alpha: Opacity of each ghost at each pixel, in [0, 1].
        ghost_depth: Camera-space z of the ghosts, in the unit of core_depth.
        ghost_colour: Colour of each ghost.

    Source: DPGS, Sec. 3.3, Eq. 8 (reading: spec, ODBP, item 6).
    """
    order = torch.sort(torch.cat([core_depth, ghost_depth]), stable=True).indices
    weights, _ = compositing.weights(torch.cat([core_alpha, ghost_alpha], dim=1)[:, order])
    return weights @ torch.cat([core_colour, ghost_colour])[order]
