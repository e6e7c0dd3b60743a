"""Gaussians from structure-from-motion points."""

import math
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.contracts.run import Run
from splatproof.methods.training.dense_points import with_dense_points
from splatproof.methods.training.matchers import matcher_words
from splatproof.reference.rasterizer.spherical_harmonics import C0
from splatproof.reference.supervision.dense_initialisation import DenseSettings
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene, SparsePoints

NEIGHBOURS = 3
RANDOM_DEPTHS = (0.1, 10.0)
"""Depths of random points, in extents of the scene."""
LEAST_EXTENT = 1e-6
"""Extent in scene units below which cameras count as standing in one place where there is no point."""
ONE_PLACE = 1e-6
"""Share of the points' distance below which cameras count as standing in one place: the centres of poses that turn
about one point differ by what rounding leaves."""
POINTS_AT_ONCE = 2**16
"""Points that are projected at once; memory only."""
LEAST_SQUARED = 1e-7
"""Floor of the mean squared distance, in squared scene units (duplicates have 0)."""
LEAST_SHARE = 1e-3
"""The floor as a share of the median of those that are apart, at most: in kilometres nearly all points lie closer than the
other one, and would start as wide as each other."""


def neighbour_distance(points: Float[Tensor, "n 3"], lone: float) -> Float[Tensor, " n"]:
    """Root of the mean squared distance to the 3 nearest other points, at least that of LEAST_SQUARED or LEAST_SHARE.

    With fewer than 4 points all others are taken.

    Args:
        points: Positions in scene units; computed in float64, so UTM-sized ones are safe.
        lone: What a single point gets, in scene units.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 5.1, and its release (mean of the
        squared distances, not squared mean; the release leaves 1e18 with fewer than 4 points).
    """
    others = min(NEIGHBOURS, len(points) - 1)
    if others < 1:
        return torch.full((len(points),), lone, dtype=torch.float64)
    positions = points.double().numpy()
    distances, _ = KDTree(positions).query(positions, k=others + 1)  # the first is itself
    squared = (distances[:, 1:] ** 2).mean(axis=1)
    apart = squared[squared > 0]
    floor = min(LEAST_SQUARED, LEAST_SHARE * np.median(apart)) if len(apart) else LEAST_SQUARED
    return torch.from_numpy(np.sqrt(np.maximum(squared, floor)))


def extent(scene: Scene) -> float:
    """Size of the scene: 1.1 times the largest distance of a training camera to their mean.

    Where all training cameras share one centre, to rounding, 1.1 times the median distance of the points
    to it. Scene units.

    Source: the 3DGS release; one centre: ours (its value 0 would freeze all positions).
    """
    centres = torch.stack([view.camera.centre.double() for view in scene.train_views])
    middle = centres.mean(dim=0)
    radius = float((centres - middle).norm(dim=1).max())
    if len(scene.points):
        distance = float((scene.points.positions.double() - middle).norm(dim=1).median())
        radius = distance if radius <= ONE_PLACE * distance else radius
    return 1.1 * radius


def with_points(
    scene: Scene,
    run: Run,
    *,
    random_points: int = 0,
    dense_cell: float = 0,
    dense: DenseSettings | None = None,
) -> Scene:
    """The scene with the points that training starts from.

    Args:
        scene: The scene, with its own points if it has any.
        run: Seed of the draw and bound on images in memory; it is told where photos give no points, and its record
            whose weights matched them, and whether ours know such scenes.
        random_points: Points to draw where the scene has none; 0: none.
        dense_cell: Pixels a point that is matched between photos before training; 0: none are.
        dense: Which photos are matched, and which matches become points; None: by the defaults.
    """
    scene = with_random_points(scene, random_points, run.seed)
    if dense_cell:
        dense = dense or DenseSettings()
        scene = with_dense_points(scene, dense_cell, run.image_bytes, dense, run.say)
        said = matcher_words(dense, scene)
        if said:
            run.on_fact("matcher", said)
    return scene


def with_random_points(scene: Scene, count: int, seed: int) -> Scene:
    """The scene with points drawn at random where it has none; a scene with points as it is.

    A point lies on the ray through a uniform place in the image of a uniform training camera, at a
    depth that is log-uniform from 0.1 to 10 extents, of cameras that are all in one place 0.1 to 10 scene
    units: from there nothing says how far away anything is. Colours are uniform. Every point is in sight,
    whether cameras look inwards, ahead or down, near or far for how they are spread; its track is
    the one view that it was drawn in.

    Args:
        scene: The scene; random points are for one that has none.
        count: Number of points to draw; 0 leaves the scene alone.
        seed: Seed of the draw.

    Source: ours; gsplat and the release's Blender scenes draw from a cube, which holds what
        cameras look at only where they stand around it.
    """
    if len(scene.points) or not count or not scene.train:
        return scene
    generator = torch.Generator().manual_seed(seed)
    draws = torch.rand(count, 3, generator=generator).double()
    chosen = torch.randint(0, len(scene.train), (count,), generator=generator)
    cameras = [view.camera for view in scene.train_views]
    sizes = torch.tensor([[camera.width, camera.height] for camera in cameras]).double()
    pixels = torch.cat([draws[:, :2] * sizes[chosen], torch.ones(count, 1)], dim=1)
    reach = extent(scene)
    reach = 1.0 if reach < LEAST_EXTENT else reach
    near, far = (math.log(factor * reach) for factor in RANDOM_DEPTHS)
    depth = (near + (far - near) * draws[:, 2:]).exp()
    to_ray = torch.stack([camera.K.double().inverse() for camera in cameras])[chosen]
    pose = torch.stack([camera.world_to_camera.double() for camera in cameras])[chosen]
    local = depth * torch.einsum("nij,nj->ni", to_ray, pixels) - pose[:, :3, 3]
    positions = torch.einsum("nji,nj->ni", pose[:, :3, :3], local)
    return replace(
        scene,
        points=SparsePoints(
            positions=positions,
            colours=torch.randint(0, 256, (count, 3), generator=generator, dtype=torch.uint8),
            track_starts=torch.arange(count + 1),
            track_views=torch.tensor(scene.train, dtype=torch.int64)[chosen],
        ),
    )


def require_points(scene: Scene) -> None:
    """Refuse a scene that no training can start from.

    Args:
        scene: Points and training views are looked at.

    Raises: DataError if there is no point or no training view.
    """
    if not scene.train:
        raise DataError(f"scene {scene.name!r}: no training views. Expected at least one")
    if len(scene.points) == 0:
        raise DataError(
            f"scene {scene.name!r}: 0 sparse points. Expected at least one to start from; `bench fit "
            "--points triangulated` makes some from the training photos under their given poses (in a "
            'protocol: points = "triangulated"), or set random_points to start from points drawn at '
            "random"
        )


def require_sight(scene: Scene) -> None:
    """Refuse a scene of whose points no training photo shows any: its model would show nothing, and learn nothing.

    One without points, or with LiDAR sweeps to start from, passes.

    Args:
        scene: Points and the cameras of the training views are looked at.

    Raises: DataError, with what lies in the way.
    """
    views, positions = scene.train_views, scene.points.positions
    if not len(positions) or not views or any(view.load_sweep for view in views):
        return
    nearest = -math.inf
    for part in positions.split(POINTS_AT_ONCE):
        for camera in (view.camera for view in views):
            at, z = project_points(camera, part)
            size = at.new_tensor([camera.width, camera.height])
            if bool(((z > camera.near) & ((at >= 0) & (at <= size)).all(dim=1)).any()):
                return
            nearest = max(nearest, float(z.max()))
    near = views[0].camera.near
    if nearest <= 0:
        why = "all lie behind the cameras; say which axes and which way the poses have"
    elif nearest <= near:
        why = (
            f"none is farther than {nearest:g} units from a camera, and below {near:g} nothing is "
            "drawn; give the scene in a smaller unit of length"
        )
    else:
        why = "all lie beside the pictures; are poses and points of one model?"
    raise DataError(
        f"scene {scene.name!r}: none of the {len(views)} training photos shows any of the "
        f"{len(positions)} sparse points: {why}"
    )


def from_points(scene: Scene, *, degree: int, opacity: float) -> Gaussians:
    """One isotropic Gaussian for each sparse point: its colour as SH DC, identity rotation.

    Args:
        scene: The scene, with sparse points and training views.
        degree: Degree of the spherical harmonics, 0 to 3; higher bands start at 0.
        opacity: Opacity of each Gaussian, in (0, 1).

    Raises: DataError if there is no point or no training view.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 5.1.
    """
    require_points(scene)
    count = len(scene.points)
    distance = neighbour_distance(scene.points.positions, lone=0.01 * extent(scene))
    sh = torch.zeros(count, (degree + 1) ** 2, 3)
    sh[:, 0] = (scene.points.colours.float() / 255 - 0.5) / C0
    return Gaussians(
        means=scene.points.positions.float(),
        quaternions=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        log_scales=distance.log().float()[:, None].repeat(1, 3),
        opacity_logits=torch.full((count,), opacity).logit(),
        sh=sh,
    )
