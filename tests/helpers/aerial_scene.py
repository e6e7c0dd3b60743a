"""A scene seen from above, small enough to train on in a test: a textured floor with a block on it."""

from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import DepthPrior, Scene, SparsePoints, View

FLOOR, ROOF = 4.0, 3.0
"""Distance of both from the plane that the cameras stand in; cameras look along z, so up is -z."""
SIDE = 0.6
"""Half the block's edge."""


def camera(index: int, *, width: int = 24, height: int = 18) -> Camera:
    """One of a row of cameras at z = 0."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 3] = 0.5 * index - 0.5
    K = torch.tensor([[24.0, 0, width / 2], [0, 24.0, height / 2], [0, 0, 1]], dtype=torch.float64)
    return Camera(K=K, world_to_camera=pose, width=width, height=height)


def depth_of(where: Camera) -> Float[Tensor, "h w"]:
    """True z-depth, float64: the roof where a ray hits it, else the floor."""
    roof = unproject(where, torch.full((where.height, where.width), ROOF))
    hit = (roof[:, :2].abs() <= SIDE).all(dim=1).reshape(where.height, where.width)
    return torch.where(hit, ROOF, FLOOR).double()


def photo_of(where: Camera) -> Float[Tensor, "h w 3"]:
    """Colours that depend on the place alone; the roof is red."""
    depth = depth_of(where)
    x, y, z = unproject(where, depth).unbind(dim=1)
    floor = torch.stack([0.2 + 0 * x, 0.5 + 0.3 * torch.sin(5 * x), 0.5 + 0.3 * torch.cos(4 * y)])
    roof = torch.stack([0.9 + 0 * x, 0.1 + 0 * x, 0.1 + 0 * x])
    image = torch.where(z < (FLOOR + ROOF) / 2, roof, floor).T
    return image.reshape(where.height, where.width, 3).float()


def prior_of(where: Camera) -> DepthPrior:
    """True disparity in a scale and with a zero of nobody's knowledge."""
    disparity = (3 / depth_of(where) + 0.4).float()
    return DepthPrior(disparity=disparity, valid=torch.ones_like(disparity, dtype=torch.bool))


def view(index: int, *, prior: bool = False) -> View:
    """The view of that camera."""
    where = camera(index)
    photo = photo_of(where)
    return View(
        name=f"{index}.png", camera=where, load=partial(torch.clone, photo),
        load_prior=partial(prior_of, where) if prior else None,
    )  # fmt: skip


def aerial_scene(*, views: int = 4, points: int = 30, prior: bool = False) -> Scene:
    """View 0 is held out; the points lie on what the views see, each in the tracks of all that see it."""
    made = tuple(view(i, prior=prior) for i in range(views))
    draw = torch.Generator().manual_seed(0)
    seen = torch.cat([unproject(v.camera, depth_of(v.camera)) for v in made])
    chosen = seen[torch.randperm(len(seen), generator=draw)[:points]]
    tracks = [[i for i, v in enumerate(made) if _shows(v.camera, point[None])] for point in chosen]
    return Scene(
        name="above", root=None, views=made, train=tuple(range(1, views)), test=(0,),
        points=SparsePoints(
            positions=chosen, colours=torch.full((len(chosen), 3), 128, dtype=torch.uint8),
            track_starts=torch.tensor([0, *map(len, tracks)]).cumsum(0),
            track_views=torch.tensor([i for track in tracks for i in track], dtype=torch.int64),
        ),
        up=torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64), units="sfm",
        shift=torch.zeros(3, dtype=torch.float64),
    )  # fmt: skip


def _shows(where: Camera, point: Float[Tensor, "1 3"]) -> bool:
    at, z = project_points(where, point)
    inside = bool(((at >= 0) & (at < at.new_tensor([where.width, where.height]))).all())
    if not inside:
        return False
    column, row = at[0].long().tolist()
    return abs(float(depth_of(where)[row, column] - z[0])) < 1e-6


def without_points(scene: Scene, view: int | None = None) -> Scene:
    """The scene without any point, or with none in the tracks of one view."""
    points = scene.points
    if view is None:
        none = SparsePoints(
            positions=points.positions[:0], colours=points.colours[:0],
            track_starts=torch.zeros(1, dtype=torch.int64), track_views=points.track_views[:0],
        )  # fmt: skip
        return replace(scene, points=none)
    rows = torch.repeat_interleave(torch.arange(len(points)), points.track_starts.diff())
    kept = points.track_views != view
    counts = torch.bincount(rows[kept], minlength=len(points))
    starts = torch.cat([torch.zeros(1, dtype=torch.int64), counts.cumsum(0)])
    tracks = replace(points, track_starts=starts, track_views=points.track_views[kept])
    return replace(scene, points=tracks)
