"""Layered depth image (LDI): the memory that accumulates geometry seen from one reference camera."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from splatproof.reference.types.camera import Camera, project_points


@dataclass(frozen=True, kw_only=True, eq=False)
class LayeredDepth:
    """Per pixel of the reference camera an ordered list of layers, flat, sorted by (pixel, depth).

    Source: StratoSplat, Sec. 3.2, Eq. 2.
    """

    camera: Camera
    merge_distance: float
    """eps_d: layers of a pixel always differ by more than this depth. Scene units."""
    most_layers: int
    """Cap on the layers of a pixel."""
    pixels: Int[Tensor, " n"]
    """Row-major pixel index of each layer."""
    depths: Float[Tensor, " n"]
    """z-depth in the reference camera, strictly increasing within a pixel."""
    positions: Float[Tensor, "n 3"]
    """World positions of the layers, scene units."""
    colours: Float[Tensor, "n 3"]
    """sRGB colours of the layers, in [0, 1]."""
    counts: Int[Tensor, " n"]
    """How many samples each layer holds."""
    forced: int = 0
    """How many merges were only made to keep the cap; more than 0 must be reported."""
    unseen: int = 0
    """How many samples the reference camera did not see, and the memory does not hold; more than 0
    must be reported."""

    def __len__(self) -> int:
        """Return the number of layers."""
        return len(self.depths)


def empty(camera: Camera, merge_distance: float, most_layers: int = 8) -> LayeredDepth:
    """An LDI without layers.

    Args:
        camera: Reference camera C_ref; it keeps only what it sees (nadir_reference sees all).
        merge_distance: eps_d > 0 in scene units (paper: 0.02 for 3DAS, 0.55 for LEVIR-NVS).
        most_layers: Cap on the layers of a pixel, at least 1.

    Raises: ValueError if the distance is not positive or the cap is below 1.
    """
    if not merge_distance > 0 or most_layers < 1:
        raise ValueError(f"need merge_distance > 0 and a cap >= 1: {merge_distance}, {most_layers}")
    none = torch.zeros(0, dtype=torch.float64)
    whole = torch.zeros(0, dtype=torch.int64)
    return LayeredDepth(
        camera=camera, merge_distance=merge_distance, most_layers=most_layers,
        pixels=whole, depths=none, positions=none.reshape(0, 3), colours=none.reshape(0, 3),
        counts=whole,
    )  # fmt: skip


def insert(
    memory: LayeredDepth, positions: Float[Tensor, "n 3"], colours: Float[Tensor, "n 3"]
) -> LayeredDepth:
    """Add samples: those within eps_d of a layer are averaged into it, the others become layers.

    A merge weights each side by the samples it holds (the paper says "averaging"): so the order
    inside a batch does not matter. Merged layers can come within eps_d of a neighbour; merging
    goes on, nearest pairs first, until all layers of a pixel are more than eps_d apart. Samples
    outside the reference image or not in front of it are only counted (`unseen`).

    Args:
        memory: The LDI so far; it is left as it is.
        positions: World positions of the new samples, scene units.
        colours: sRGB colours of the new samples, in [0, 1].

    Source: StratoSplat, Sec. 3.2, "Layered Memory".
    """
    camera = memory.camera
    positions, colours = positions.to(memory.depths), colours.to(memory.depths)
    at, z = project_points(camera, positions)
    size = at.new_tensor([camera.width, camera.height])
    inside = (z > camera.near) & (at >= 0).all(dim=1) & (at < size).all(dim=1)
    column, row = at[inside].long().unbind(dim=1)
    merged = replace(
        memory,
        unseen=memory.unseen + int((~inside).sum()),
        pixels=torch.cat([memory.pixels, row * camera.width + column]),
        depths=torch.cat([memory.depths, z[inside]]),
        positions=torch.cat([memory.positions, positions[inside]]),
        colours=torch.cat([memory.colours, colours[inside]]),
        counts=torch.cat([memory.counts, torch.ones_like(column)]),
    )
    merged = _sorted(merged)
    while (pairs := _close_pairs(merged)).any():
        merged = _merge(merged, pairs)
    while (pairs := _pairs_over_the_cap(merged)).any():
        merged = _merge(replace(merged, forced=merged.forced + int(pairs.sum())), pairs)
    return merged


def _sorted(memory: LayeredDepth) -> LayeredDepth:
    """Layers in order of pixel, then depth."""
    by_depth = torch.sort(memory.depths, stable=True).indices
    order = by_depth[torch.sort(memory.pixels[by_depth], stable=True).indices]
    return replace(
        memory, pixels=memory.pixels[order], depths=memory.depths[order],
        positions=memory.positions[order], colours=memory.colours[order],
        counts=memory.counts[order],
    )  # fmt: skip


def _gaps(memory: LayeredDepth) -> Float[Tensor, " n"]:
    """Depth from each layer to the next one of its pixel; infinite for the last one."""
    last = memory.pixels[1:] != memory.pixels[:-1]
    gaps = torch.full_like(memory.depths, torch.inf)
    gaps[:-1] = torch.where(last, torch.inf, memory.depths[1:] - memory.depths[:-1])
    return gaps


def _nearest_neighbours(gaps: Float[Tensor, " n"]) -> Bool[Tensor, " n"]:
    """Layers whose gap to the next is the smallest on both sides (of equal gaps the first)."""
    before = torch.cat([gaps.new_full((1,), torch.inf), gaps[:-1]])
    after = torch.cat([gaps[1:], gaps.new_full((1,), torch.inf)])
    return (gaps < before) & (gaps <= after) & gaps.isfinite()


def _close_pairs(memory: LayeredDepth) -> Bool[Tensor, " n"]:
    """Layers to merge with the next one because they lie within eps_d; pairs never overlap."""
    gaps = _gaps(memory)
    return _nearest_neighbours(gaps) & (gaps <= memory.merge_distance)


def _pairs_over_the_cap(memory: LayeredDepth) -> Bool[Tensor, " n"]:
    """The closest pair of each pixel that has too many layers."""
    gaps = _gaps(memory)
    total = memory.camera.width * memory.camera.height
    full = torch.bincount(memory.pixels, minlength=total) > memory.most_layers
    closest = torch.full((total,), torch.inf, dtype=gaps.dtype)
    closest = closest.scatter_reduce(0, memory.pixels, gaps, "amin")
    index = torch.arange(len(gaps))
    chosen = index[full[memory.pixels] & (gaps == closest[memory.pixels])]
    # Equal gaps in one pixel: the first of them, so that no layer is merged that has room.
    first = torch.full((total,), len(gaps))
    first = first.scatter_reduce(0, memory.pixels[chosen], chosen, "amin")
    return index == first[memory.pixels]


def _merge(memory: LayeredDepth, pairs: Bool[Tensor, " n"]) -> LayeredDepth:
    """Replace each marked layer and the one after it by their mean, weighted by their counts."""
    first = torch.where(pairs)[0]
    second = first + 1
    counts = memory.counts.to(memory.depths)  # float32 division of integers would lose digits
    share = counts[second] / (counts[first] + counts[second])

    def mean(values: Tensor) -> Tensor:
        weight = share.to(values).reshape(-1, *[1] * (values.ndim - 1))
        blended = values.clone()
        blended[first] = values[first] + weight * (values[second] - values[first])
        return blended[keep]

    keep = torch.ones_like(pairs)
    keep[second] = False
    held = memory.counts.clone()
    held[first] += memory.counts[second]
    return replace(
        memory, pixels=memory.pixels[keep], depths=mean(memory.depths),
        positions=mean(memory.positions), colours=mean(memory.colours), counts=held[keep],
    )  # fmt: skip
