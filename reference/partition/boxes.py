"""Boxes that bound blocks: axis-aligned and oriented, and the normalised distance to a block."""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError

THINNEST = 1e-9
"""Share of the longest half-extent below which another one counts as zero."""


@runtime_checkable
class Region(Protocol):
    """Where a block lies: an oriented box, or any other shape with a distance that is scaled alike."""

    @property
    def centre(self) -> Float[Tensor, "3"]:
        """A place that tells blocks apart, in the scene's frame."""
        ...

    def distance(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Normalised distance: at most 1 in the block, 1 on its surface, above 1 outside."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """An axis-aligned box, closed on all sides; an axis may have zero size."""

    low: Float[Tensor, "3"]
    high: Float[Tensor, "3"]


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientedBox:
    """A rotated box { p : |diag(e)^-1 R (p - c)|_inf <= 1 }.

    Raises: DataError for half-extents that are not positive and finite, or of which one is below
        1e-9 of the largest: rounding leaves that much of a zero.

    Source: StitchGS, Sec. 3.2.1 and 3.2.3.
    """

    centre: Float[Tensor, "3"]
    rotation: Float[Tensor, "3 3"]
    """R: its rows are the box axes in the world, orthonormal."""
    half: Float[Tensor, "3"]
    """Half-extents e along the box axes, in scene units."""

    def __post_init__(self) -> None:
        """Refuse a box without volume: distances to it are undefined."""
        thick = self.half > THINNEST * self.half.max()
        if not bool((thick & self.half.isfinite()).all()):
            raise DataError(
                f"oriented box with half-extents {self.half.tolist()}: expected three positive "
                "lengths; give the block some thickness or leave it out"
            )

    def distance(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Normalised distance of box_distance: an oriented box is a Region."""
        return box_distance(self, points)


def bounds(points: Float[Tensor, "n 3"]) -> Box:
    """Smallest box around the points.

    Raises: DataError without points.
    """
    if len(points) == 0:
        raise DataError("a box around no points: expected at least one point in each block")
    return Box(low=points.amin(dim=0), high=points.amax(dim=0))


def widen(box: Box, share: float) -> Box:
    """Box longer by `share` of each axis: [low - share/2 (high - low), high + share/2 (high - low)].

    Args:
        box: The core box: bounds of the points that a block owns.
        share: alpha >= 0; the paper's 0.2 adds a tenth of the size on each side.

    Source: DPGS, Sec. 3.3, Eq. 7.
    """
    rim = share / 2 * (box.high - box.low)
    return Box(low=box.low - rim, high=box.high + rim)


def inside(box: Box, points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
    """Which points lie in the box, borders included.

    Args:
        box: The box, in the frame and unit of the points.
        points: Positions to be tested.
    """
    return ((points >= box.low) & (points <= box.high)).all(dim=1)


def widen_oriented(box: OrientedBox, margin: float) -> OrientedBox:
    """Box with half-extents e (1 + margin), about the same centre.

    Args:
        box: A block's box before the margin.
        margin: Share lambda_margin >= 0 by which each half-extent grows.

    Source: StitchGS, Sec. 3.2.1 (T_expand with lambda_margin).
    """
    return replace(box, half=box.half * (1 + margin))


def box_distance(box: OrientedBox, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Normalised distance d(p) = |diag(e)^-1 R (p - c)|_inf: 1 on the box's surface.

    Args:
        box: The oriented box; it is cast to the points' dtype.
        points: World positions in scene units.

    Source: StitchGS, Sec. 3.2.3 (d_i).
    """
    local = (points - box.centre.to(points)) @ box.rotation.to(points).T
    return (local / box.half.to(points)).abs().amax(dim=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class WidenedRegion:
    """A region that is 1 + margin times as large, as its distances tell: d(p) / (1 + margin).

    Of an oriented box it is that of `widen_oriented`.

    Source: StitchGS, Sec. 3.2.1 (T_expand with lambda_margin); of other shapes than boxes: ours.
    """

    region: Region
    margin: float
    """lambda_margin >= 0."""

    @property
    def centre(self) -> Float[Tensor, "3"]:
        """That of the region."""
        return self.region.centre

    def distance(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """d(p) / (1 + margin) of each position."""
        return self.region.distance(points) / (1 + self.margin)


def corners(box: OrientedBox) -> Float[Tensor, "8 3"]:
    """World positions of the eight corners; corner i has bit j of i set where axis j is positive."""
    bits = torch.arange(8)[:, None] >> torch.arange(3) & 1
    return box.centre + (2 * bits - 1).to(box.half) * box.half @ box.rotation
