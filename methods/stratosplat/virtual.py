"""Virtual Gaussians of a view: rays meet a stack of planes, and a field gives them colour and opacity."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.kernels import field
from splatproof.methods.stratosplat.settings import Planes
from splatproof.reference.layered_memory import coordinate_field, multi_plane
from splatproof.reference.layered_memory.coordinate_field import CoordinateField
from splatproof.reference.layered_memory.multi_plane import PlaneStack, Sites
from splatproof.reference.types.camera import Camera

OUTPUTS = 9
"""Numbers that the field gives at a place: colour 3, opacity logit 1, scale 1, rotation 4."""
GRIDS = 4
"""Grids of the neural field; each has twice as many cells along an axis as the one before."""
TRIMMED = 0.005
"""Share of the cloud at each end of an axis that does not set the range of planes and field: a wrong
depth must not stretch them."""
WIDER = 0.05
"""Share of its width by which the field goes beyond the cloud on each side."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stack:
    """The planes, the frame in which the field is stored, and its box; fixed before training."""

    planes: PlaneStack
    frame: Float[Tensor, "3 3"]
    """Rows: two axes along the planes, and their normal."""
    low: Float[Tensor, "3"]
    """Lower corner of the field's box in that frame, scene units."""
    high: Float[Tensor, "3"]

    def facts(self) -> dict[str, list]:
        """All of it, JSON-ready."""
        return {
            "frame": self.frame.tolist(), "offsets": self.planes.offsets.tolist(),
            "low": self.low.tolist(), "high": self.high.tolist(),
        }  # fmt: skip

    @staticmethod
    def read(facts: Mapping[str, Any]) -> "Stack":
        """What `facts` said.

        Raises: KeyError, TypeError or ValueError for what is missing or of another shape.
        """
        frame, offsets, low, high = (
            torch.tensor(facts[name], dtype=torch.float64)
            for name in ("frame", "offsets", "low", "high")
        )
        if frame.shape != (3, 3) or low.shape != (3,) or high.shape != (3,) or offsets.ndim != 1:
            raise ValueError(f"planes of shape {tuple(frame.shape)}, {tuple(offsets.shape)}")
        return Stack(
            planes=PlaneStack(normal=frame[2], offsets=offsets), frame=frame, low=low, high=high
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewSites:
    """Where one view has virtual Gaussians, ready for the field."""

    sites: Sites
    """Float32."""
    places: Float[Tensor, "n 3"]
    """Positions in the field's box, 0 to 1 on each axis, not clamped. Float32."""
    planes: Int[Tensor, " n"]
    """Plane of each."""


def stack_of(points: Float[Tensor, "n 3"], up: Float[Tensor, "3"], count: int) -> Stack:
    """Planes across the direction of least variance of a cloud, at equal distances over its range.

    Where the cloud has no such direction they lie across `up`.

    Args:
        points: Dense cloud, scene units.
        up: Unit vector against gravity.
        count: Number of planes.

    Raises: DataError for a cloud without width.

    Source: StratoSplat, Sec. 3.3, "Plane-Based Gaussian Generation"; trimming and box: ours.
    """
    try:
        normal = multi_plane.plane_normal(points, up)
    except ValueError:
        normal = up.to(points)
    side = torch.eye(3).to(normal)[normal.abs().argmin()]
    along = torch.linalg.cross(normal, side)
    along = along / along.norm()
    frame = torch.stack([along, torch.linalg.cross(normal, along), normal])
    local = (points @ frame.T).sort(dim=0).values
    last = len(local) - 1
    low, high = local[int(TRIMMED * last)], local[last - int(TRIMMED * last)]
    width = high - low
    if not bool(width[:2].amax() > 0):
        raise DataError(
            f"all {len(points)} points that planes are to cover lie on one line; take more views, or "
            "planes.field = 'none'"
        )
    # a flat cloud still gets a box with a volume
    thick = width.clamp(min=1e-3 * float(width.amax()))
    ends = torch.stack([low, high])
    return Stack(
        planes=multi_plane.plane_stack(ends @ frame, normal, count), frame=frame,
        low=low - WIDER * thick, high=high + WIDER * thick,
    )  # fmt: skip


def view_sites(stack: Stack, camera: Camera, settings: Planes) -> ViewSites:
    """The virtual Gaussians of a view before the field is asked.

    Args:
        stack: The planes.
        camera: The view's camera.
        settings: stride and bias count.
    """
    rays = multi_plane.pixel_rays(camera, settings.stride)
    hits = multi_plane.ray_hits(stack.planes, camera.centre, rays, camera.near)
    sites = multi_plane.sites_of(hits, camera, settings.stride, biased=settings.bias)
    places = (sites.positions @ stack.frame.T - stack.low) / (stack.high - stack.low)
    return ViewSites(
        sites=Sites(
            positions=sites.positions.float(), bias=sites.bias.float(),
            spacing=sites.spacing.float(),
        ),
        places=places.float(),
        planes=torch.arange(len(stack.planes.offsets)).expand_as(hits.valid)[hits.valid],
    )  # fmt: skip


def drawn_field(settings: Planes, generator: torch.Generator) -> dict[str, Tensor]:
    """The field's tensors at the start, by name; none without a field.

    Args:
        settings: field, finest and count matter.
        generator: Source of the neural field's random numbers.
    """
    if settings.field == "none":
        return {}
    if settings.field == "table":
        side = 2 * settings.finest
        return {"table": torch.zeros(settings.count, side, side, OUTPUTS)}
    sizes = tuple(settings.finest // 2**level for level in reversed(range(GRIDS)))
    drawn = coordinate_field.create(
        torch.zeros(3), torch.ones(3), OUTPUTS, generator, resolutions=sizes
    )
    # the features of a sample side by side, as the kernels read them
    named = {f"grid_{i}": grid[0].permute(1, 2, 3, 0) for i, grid in enumerate(drawn.grids)}
    return named | {name: getattr(drawn, name) for name in NETWORK}


NETWORK = ("hidden", "hidden_bias", "out", "out_bias")
"""Tensors of the neural field's network."""


def asked(tensors: Mapping[str, Tensor], view: ViewSites) -> Float[Tensor, "n 9"]:
    """What the field says at the sites of a view, differentiable by its tensors.

    Args:
        tensors: As `drawn_field` names them.
        view: The sites.
    """
    table = tensors.get("table")
    if table is None:
        grids = [tensors[f"grid_{i}"] for i in range(GRIDS)]
        places = view.places.to(grids[0])
        if places.device.type == "cpu" and places.dtype == torch.float32:
            return field.evaluate(places, grids, [tensors[name] for name in NETWORK])
        return coordinate_field.evaluate(unit_field(tensors), places)
    side = table.shape[1]
    column, row = (view.places[:, :2] * side).long().clamp(0, side - 1).unbind(dim=1)
    index = (view.planes * side + row) * side + column
    return table.reshape(-1, OUTPUTS).index_select(0, index)


def unit_field(tensors: Mapping[str, Tensor]) -> CoordinateField:
    """The neural field as the reference takes it, over the unit box.

    Args:
        tensors: As `drawn_field` names them.
    """
    grids = tuple(tensors[f"grid_{i}"].permute(3, 0, 1, 2)[None] for i in range(GRIDS))
    return CoordinateField(
        low=grids[0].new_zeros(3), high=grids[0].new_ones(3), grids=grids,
        **{name: tensors[name] for name in NETWORK},
    )  # fmt: skip


def hits_of(settings: Planes, camera: Camera) -> int:
    """Most virtual Gaussians of a view.

    Args:
        settings: field, count and stride matter.
        camera: The view's camera.
    """
    if settings.field == "none":
        return 0
    cells = math.ceil(camera.width / settings.stride) * math.ceil(camera.height / settings.stride)
    return settings.count * cells
