"""Scaffold-GS: voxel anchors whose k neural Gaussians are decoded for each camera."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.reference.rasterizer import rotation
from splatproof.reference.types import mlp
from splatproof.reference.types.cells import unique_rows
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.splats import Splats


@dataclass(frozen=True, kw_only=True, eq=False)
class Anchors:
    """What is stored and trained for each anchor."""

    centres: Float[Tensor, "n 3"]
    """Voxel centres, scene units; they never move, unless a depth constraint gives them a rate."""
    offsets: Float[Tensor, "n k 3"]
    """Where the k Gaussians stand about the centre, in units of the anchor's offset scale."""
    features: Float[Tensor, "n f"]
    log_scales: Float[Tensor, "n 6"]
    """The first three scale the offsets, the last three are the base scale of the Gaussians."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Decoder:
    """The three networks; each reads feature, view direction and, as an option, distance."""

    opacity: Mlp
    """k outputs, one a Gaussian, then tanh."""
    shape: Mlp
    """7 k outputs, for each Gaussian a scale factor (3, sigmoid) and a quaternion (4)."""
    colour: Mlp
    """3 k outputs, then sigmoid."""


def create_decoder(
    features: int,
    k: int,
    generator: torch.Generator,
    *,
    extra: int = 3,
    dtype: torch.dtype = torch.float32,
) -> Decoder:
    """Networks of one hidden layer as wide as the feature.

    Args:
        features: Feature channels (the release: 32).
        k: Gaussians an anchor (the release: 10).
        generator: Source of the random weights.
        extra: Numbers beside the feature: 3 for the direction, 4 with the distance.
        dtype: Dtype of the parameters.

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.2 and its release.
    """
    widths = {"opacity": k, "shape": 7 * k, "colour": 3 * k}
    sizes = {name: (features + extra, features, out) for name, out in widths.items()}
    made = {name: mlp.create(size, generator, dtype) for name, size in sizes.items()}
    return Decoder(**made)


def anchor_voxels(points: Float[Tensor, "n 3"], voxel: float) -> Float[Tensor, "m 3"]:
    """Distinct voxel centres round(p / voxel) * voxel of a cloud.

    Args:
        points: Positions of the cloud in scene units.
        voxel: Edge of a voxel in scene units, > 0.

    Raises: ValueError if the voxel size is not positive.

    Source: Lu et al. 2024, "Scaffold-GS", Eq. 4.
    """
    if not voxel > 0:
        raise ValueError(f"voxel size must be positive: {voxel}")
    return unique_rows((points / voxel).round().long())[0].to(points) * voxel


def view_code(
    centres: Float[Tensor, "n 3"], camera_centre: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 1"]]:
    """Unit direction from camera to anchor, and distance; direction 0 where they meet.

    Args:
        centres: Anchor positions in the world, scene units.
        camera_centre: Centre of the camera in the world, scene units.
    """
    offset = centres - camera_centre.to(centres)
    square = offset.square().sum(dim=1, keepdim=True)
    apart = square > 0
    distance = torch.where(apart, torch.where(apart, square, 1).sqrt(), 0)
    return offset / torch.where(apart, distance, 1), distance


def blend_bank(
    features: Float[Tensor, "n f"],
    network: Mlp,
    direction: Float[Tensor, "n 3"],
    distance: Float[Tensor, "n 1"],
) -> Float[Tensor, "n f"]:
    """The feature bank: w0 f[::4] + w1 f[::2] + w2 f, thinned features repeated to full length.

    Args:
        features: Features of each anchor, one row an anchor; f is a multiple of 4.
        network: From direction and distance (4 numbers) to 3, softmax of which are the weights w.
        direction: Unit directions from the camera, from `view_code`.
        distance: Distances to the camera in scene units, from `view_code`.

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.2 and its release.
    """
    code = torch.cat([direction, distance], dim=1)
    weights = torch.softmax(mlp.evaluate(network, code), dim=1)
    coarse, middle = features[:, ::4].repeat(1, 4), features[:, ::2].repeat(1, 2)
    return weights[:, :1] * coarse + weights[:, 1:2] * middle + weights[:, 2:] * features


def decode(
    anchors: Anchors,
    decoder: Decoder,
    camera_centre: Float[Tensor, "3"],
    *,
    with_distance: bool = False,
) -> Splats:
    """Gaussians of all anchors as one camera sees them; slots whose opacity is <= 0 are left out.

    mean = centre + offset * exp(ls[:3]), scale = exp(ls[3:]) * sigmoid(.), colour = sigmoid(.).

    Args:
        anchors: The stored anchors.
        decoder: The three networks, from `create_decoder`; extra = 4 if they read the distance.
        camera_centre: Centre of the camera in the world, scene units.
        with_distance: Whether the networks also read the distance from the camera to the anchor.

    Source: Lu et al. 2024, "Scaffold-GS", Eqs. 5 to 7.
    """
    count, k, _ = anchors.offsets.shape
    direction, distance = view_code(anchors.centres, camera_centre)
    extra = [direction, distance] if with_distance else [direction]
    code = torch.cat([anchors.features, *extra], dim=1)
    opacity = torch.tanh(mlp.evaluate(decoder.opacity, code)).reshape(count * k)
    shape = mlp.evaluate(decoder.shape, code).reshape(count * k, 7)
    colour = torch.sigmoid(mlp.evaluate(decoder.colour, code)).reshape(count * k, 3)
    reach, base = anchors.log_scales.exp().split(3, dim=1)
    means = (anchors.centres[:, None] + anchors.offsets * reach[:, None]).reshape(count * k, 3)
    scales = base.repeat_interleave(k, dim=0) * torch.sigmoid(shape[:, :3])
    slots = torch.where(opacity > 0)[0]
    return Splats(
        means=means[slots],
        quaternions=rotation.normalise(shape[slots, 3:]),
        scales=scales[slots],
        opacities=opacity[slots],
        colours=colour[slots],
        rows=slots // k,
        slots=slots,
    )


def volume_loss(scales: Float[Tensor, "m 3"]) -> Float[Tensor, ""]:
    """Mean product of the three scales of the decoded Gaussians; 0 without any.

    Source: Lu et al. 2024, "Scaffold-GS", Eq. 9 (a sum there, a mean in its release).
    """
    x, y, z = scales.unbind(dim=1)
    return (x * y * z).sum() / max(1, len(scales))


def candidates(
    gradients: Float[Tensor, " m"],
    counts: Int[Tensor, " m"],
    level: int,
    threshold: float,
    least: int,
    draw: Float[Tensor, " m"],
) -> Bool[Tensor, " m"]:
    """Slots that ask for a new anchor at a level: mean gradient >= threshold * 2^level.

    Args:
        gradients: Sum of 2D gradient norms of each slot.
        counts: How often each slot was drawn.
        level: Level of the grid, 0 the coarsest, whose cells are to hold the new anchors.
        threshold: Mean gradient from which a slot asks at level 0; it doubles with each level.
        least: Slots drawn at most this often are left alone.
        draw: Uniform numbers in [0, 1): 1 - 0.5^(level + 1) of the candidates are kept.

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.3 and its release.
    """
    mean = gradients / counts.clamp(min=1)
    return (mean >= threshold * 2**level) & (counts > least) & (draw > 0.5 ** (level + 1))


def grow(
    anchors: Anchors,
    positions: Float[Tensor, "m 3"],
    wanted: Bool[Tensor, " m"],
    cell: float,
) -> Anchors:
    """Add an anchor in every cell that holds a wanted slot and no anchor yet.

    New anchors sit at round(p / cell) * cell, with zero offsets, log scales log(cell) and the
    element-wise maximum of the features of the anchors whose slots asked for them.

    Args:
        anchors: The anchors so far, which stay as they are and come first in the result.
        positions: Means of all n * k slots, in scene units, in the order anchor * k + offset.
        wanted: Which slots ask for an anchor, from `candidates`.
        cell: Edge of the level's cells in scene units, > 0.

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.3 and its release.
    """
    k = anchors.offsets.shape[1]
    asked = (positions[wanted] / cell).round().long()
    parents = torch.where(wanted)[0] // k
    taken = {tuple(row) for row in (anchors.centres / cell).round().long().tolist()}
    free = torch.tensor([tuple(row) not in taken for row in asked.tolist()], dtype=torch.bool)
    cells, owner = unique_rows(asked[free])
    sources = anchors.features[parents[free]]
    strongest = sources.new_full((len(cells), sources.shape[1]), -torch.inf)
    strongest = strongest.scatter_reduce(
        0, owner[:, None].expand_as(sources), sources, "amax", include_self=True
    )
    size = anchors.log_scales.new_tensor(cell).log()
    return Anchors(
        centres=torch.cat([anchors.centres, cells.to(anchors.centres) * cell]),
        offsets=torch.cat([anchors.offsets, anchors.offsets.new_zeros(len(cells), k, 3)]),
        features=torch.cat([anchors.features, strongest]),
        log_scales=torch.cat([anchors.log_scales, size.expand(len(cells), 6)]),
    )


def keep_visible(
    opacity_sums: Float[Tensor, " n"],
    visits: Int[Tensor, " n"],
    *,
    threshold: float = 0.005,
    least: int = 80,
) -> Bool[Tensor, " n"]:
    """Anchors to keep: seen at most `least` times so far, or mean total opacity >= threshold.

    Args:
        opacity_sums: Sum over visits of the anchor's summed positive opacities.
        visits: In how many iterations the anchor was visible.
        threshold: Least mean, over its visits, of an anchor's summed opacity.
        least: An anchor with at most this many visits is kept, since too little is known of it.

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.3 and its release.
    """
    return (opacity_sums >= threshold * visits) | (visits <= least)
