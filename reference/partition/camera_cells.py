"""VastGaussian's partition: cells with equally many cameras, then whatever sees their airspace."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.reference.partition.boxes import OrientedBox
from splatproof.reference.partition.frustum import image_share
from splatproof.reference.types.camera import Camera, project_points

MARGIN = 0.2
"""A cell is widened by this share of its width on each side before cameras and points are taken."""
SHARE = 0.25
"""A camera is added when the cell's airspace fills at least this share of its image."""
TRIM = 0.01
"""Share of a cell's points that may lie below, and above, its airspace (outliers)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraGrid:
    """Columns along x, each cut into rows along y, in the ground frame."""

    column_walls: Float[Tensor, " columns_plus_1"]
    """x of the walls; first and last are the outermost cameras'."""
    row_walls: Float[Tensor, "columns rows_plus_1"]
    """y of the walls in each column."""

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of columns and of rows."""
        return len(self.row_walls), self.row_walls.shape[1] - 1

    def cell(self, block: int) -> Float[Tensor, "2 2"]:
        """Lower and upper corner (x, y) of block `column * rows + row`."""
        column, row = divmod(block, self.shape[1])
        x, y = self.column_walls[column : column + 2], self.row_walls[column, row : row + 2]
        return torch.stack([x, y], dim=1)


def camera_grid(centres: Float[Tensor, "v 2"], columns: int, rows: int) -> CameraGrid:
    """Cut the ground so that each cell holds equally many cameras (the last of a line the rest).

    Cameras sorted by x are cut into columns, each of them sorted by y into rows; a wall stands at
    the last camera before it.

    Args:
        centres: Camera centres on the ground (x, y).
        columns: Number m >= 1 of columns along x.
        rows: Number n >= 1 of cells that each column is cut into along y.

    Raises: DataError for fewer cameras than cells.

    Source: VastGaussian, Sec. 4.1 (camera-position-based region division).
    """
    if len(centres) < columns * rows:
        raise DataError(f"{columns} x {rows} cells for {len(centres)} cameras: ask for fewer cells")
    parts = _equal_parts(centres[centres[:, 0].argsort(stable=True)], columns)
    lines = [_equal_parts(part[part[:, 1].argsort(stable=True)], rows) for part in parts]
    return CameraGrid(
        column_walls=_walls(parts, 0), row_walls=torch.stack([_walls(line, 1) for line in lines])
    )


def owner_cell(grid: CameraGrid, points: Float[Tensor, "n 2"]) -> Int64[Tensor, " n"]:
    """Block that owns each ground position; outer cells are unbounded, walls belong below.

    The merge rule: block k keeps the Gaussians whose means it owns. The published code keeps those
    in the widened cell and so doubles what lies in overlaps; the paper's original cell is used here.

    Args:
        grid: The cells, from `camera_grid`.
        points: Positions (x, y) in the ground frame, scene units.

    Returns: Block `column * rows + row` of each position.

    Source: VastGaussian, Sec. 4.3 (seamless merging).
    """
    inner = grid.column_walls[1:-1].contiguous()
    column = torch.bucketize(points[:, 0].contiguous(), inner)
    row = (points[:, 1:] > grid.row_walls[column, 1:-1]).sum(dim=1)
    return column * grid.shape[1] + row


def in_widened_cell(
    grid: CameraGrid, block: int, points: Float[Tensor, "n 2"], *, margin: float = MARGIN
) -> Bool[Tensor, " n"]:
    """Cameras or points in the block's cell, widened by `margin` of its width on each side.

    Args:
        grid: The cells, from `camera_grid`.
        block: Number of the block, `column * rows + row`.
        points: Positions (x, y) of camera centres or points in the ground frame, scene units.
        margin: Share >= 0 of the cell's width that is added on each side.

    Source: VastGaussian, Sec. 4.1 (position-based data selection).
    """
    low, high = grid.cell(block)
    rim = margin * (high - low)
    return ((points >= low - rim) & (points <= high + rim)).all(dim=1)


def airspace(
    frame: Float[Tensor, "3 3"], cell: Float[Tensor, "2 2"], heights: Float[Tensor, " n"]
) -> OrientedBox | None:
    """Box over the cell from the ground to the highest point, empty air included; None if it is flat.

    Args:
        frame: Rotation into the ground frame (ground_frame).
        cell: Lower and upper corner on the ground.
        heights: Heights of the cell's points; 1 % of them may stick out below, and above.

    Source: VastGaussian, Sec. 4.1 (airspace-aware visibility); trimming: ours.
    """
    if len(heights) == 0:
        return None
    ends = torch.quantile(heights, heights.new_tensor([TRIM, 1 - TRIM]))
    low, high = torch.cat([cell, ends[:, None]], dim=1)
    if not bool((high > low).all()):
        return None
    middle = (low + high) / 2 @ frame
    return OrientedBox(centre=middle, rotation=frame, half=(high - low) / 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraBlock:
    """What one block trains on."""

    views: Bool[Tensor, " v"]
    points: Bool[Tensor, " n"]


def select(
    grid: CameraGrid,
    block: int,
    frame: Float[Tensor, "3 3"],
    cameras: tuple[Camera, ...],
    points: Float[Tensor, "n 3"],
) -> CameraBlock:
    """Cameras and points of a block: by position, by visibility of its airspace, by coverage.

    Cameras in the widened cell; cameras whose image the airspace over the widened cell fills to at
    least 25 %; points in the widened cell; and all points that project into an added camera, so
    that what it sees beyond the cell is not explained by floaters.

    Args:
        grid: The cells, from `camera_grid`.
        block: Number of the block, `column * rows + row`.
        frame: Rotation into the ground frame (ground_frame).
        cameras: Cameras of the training views.
        points: Sparse points in the world, scene units.

    Source: VastGaussian, Sec. 4.1.
    """
    upright = points @ frame.T
    centres = torch.stack([camera.centre for camera in cameras]) @ frame.T
    near = in_widened_cell(grid, block, centres[:, :2])
    held = in_widened_cell(grid, block, upright[:, :2])
    low, high = grid.cell(block)
    rim = MARGIN * (high - low)
    box = airspace(frame, torch.stack([low - rim, high + rim]), upright[held, 2])
    seen = [box is not None and image_share(camera, box) >= SHARE for camera in cameras]
    added = torch.tensor(seen) & ~near
    for view in added.nonzero()[:, 0].tolist():
        held = held | _projects_into(cameras[view], points)
    return CameraBlock(views=near | added, points=held)


def _projects_into(camera: Camera, points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
    """Points in front of the near plane that land on the image."""
    pixel, depth = project_points(camera, points)
    size = pixel.new_tensor([camera.width, camera.height])
    return (depth > camera.near) & ((pixel >= 0) & (pixel <= size)).all(dim=1)


def _equal_parts(sorted_rows: Float[Tensor, "v 2"], count: int) -> list[Float[Tensor, "_ 2"]]:
    """Runs of floor(v / count) rows; the last one takes the remainder."""
    each = len(sorted_rows) // count
    ends = [i * each for i in range(count)] + [len(sorted_rows)]
    return [sorted_rows[a:b] for a, b in pairwise(ends)]


def _walls(parts: list[Float[Tensor, "_ 2"]], axis: int) -> Float[Tensor, " parts_plus_1"]:
    """First camera's coordinate, then the last one's of each part."""
    return torch.stack([parts[0][0, axis]] + [part[-1, axis] for part in parts])
