"""Which pixels of a view any training photo can have shown: what no method can know is told apart."""

from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from scipy.spatial import QhullError
from torch import Tensor
from torch.nn.functional import max_pool2d

from splatproof.datasets.image_cache import TensorCache
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import Scene, SparsePoints, View

SLACK = 0.02
"""Largest share of its depth by which a surface may miss a training view's true depth around it."""
UNSURE = (0.8, 1.25)
"""Factors of a depth that sparse points alone suggest, at which a pixel may be seen too."""
FEWEST = 8
"""Points in an image below which nothing is said of its depth."""
FAR = 1e6
"""Depth in scene units, times the reach of the cameras where that is more than 1, of the sky."""
MOST_CELLS = 48
"""Rows and columns at which the depth between sparse points is interpolated."""
KEPT = 512 * 2**20
"""Bytes of training views' depth bounds that are kept for the next test view."""
MOST_RAYS = 40_000
"""Pixels of a view that are looked at; the others are as the nearest of these."""


def seen_in_training(scene: Scene) -> dict[str, Bool[Tensor, "h w"] | None]:
    """`seen_pixels` of every test view, by name.

    Args:
        scene: With its split; true depths of training views are read once, as far as KEPT allows.
    """
    kept = TensorCache(KEPT)
    return {
        scene.views[i].name: seen_pixels(scene.views[i], scene.train_views, scene.points, i, kept)
        for i in scene.test
    }


def seen_pixels(
    view: View,
    training: Sequence[View],
    points: SparsePoints,
    number: int,
    kept: TensorCache | None = None,
    *,
    most_rays: int = MOST_RAYS,
) -> Bool[Tensor, "h w"] | None:
    """Which pixels show a surface that lies in at least one training photo.

    Where this view and all training views have true depth, a surface is seen if it lands inside a
    training image at the true depth there (the range of the pixel and its eight neighbours, widened by
    SLACK); sky is seen where such an image has sky; what moves, which stood elsewhere in other photos,
    where it lands inside one. Else the depth is interpolated between the sparse
    points of the view, and a pixel counts as seen if its point at 0.8, 1 or 1.25 of that depth lands in
    any training image, whatever stands before it: False then says that no photo *can* have shown it.
    Pixels that a training image's mask hides show nothing. The model is not asked, so the answer is the
    same for every method.

    Args:
        view: The view that is scored.
        training: The views that are trained on; itself among them counts as a photo of it.
        points: Sparse points of the scene; read where true depth is not known.
        number: Index of the view in the scene, by which tracks name it.
        kept: Holds bounds of training views' depths, and their masks, for the next call; None: they are not kept.
        most_rays: Pixels that are looked at, about: the upper left one of each square cell, for all of it.
    Returns: True where seen; None where neither true depth nor enough points say how deep it is.
    Source: ours.
    """
    known = all(one.load_depth is not None for one in (view, *training))
    step = _step(view.camera, most_rays)
    if known:
        assert view.load_depth is not None
        depth = view.load_depth().double()[::step, ::step]
    else:
        found = _sparse_depth(view.camera, points, number, step)
        if found is None:
            return None
        depth = found
    loose = _moving(view)[::step, ::step] if known else torch.ones_like(depth, dtype=torch.bool)
    away = [_apart(view, one) for one in training]
    nearest = [training[i] for i in sorted(range(len(training)), key=away.__getitem__)]
    rays = _rays(view.camera, step, depth.shape)
    farthest = FAR * max([*away, 1.0])
    kept = TensorCache(0) if kept is None else kept
    seen = torch.zeros_like(depth, dtype=torch.bool)
    # where depth is not known at other depths too, before a photo is said not to show a pixel
    for factor in (1.0,) if known else (1.0, *UNSURE):
        z = (factor * depth).clamp(max=farthest)
        seen |= _seen(view.camera, rays, z, loose, nearest, kept, seen)
    return _enlarged(seen, step, view.size)


def _moving(view: View) -> Bool[Tensor, "h w"]:
    masks = {} if view.load_moving is None else view.load_moving()
    none = torch.zeros(view.size, dtype=torch.bool)
    return torch.stack([none, *masks.values()]).any(dim=0)


def _apart(view: View, other: View) -> float:
    """Distance of two cameras in scene units."""
    return float((other.camera.centre - view.camera.centre).norm())


def _step(camera: Camera, most_rays: int) -> int:
    """Distance of the rows and columns that are looked at."""
    return max(1, int(np.ceil(np.sqrt(camera.width * camera.height / most_rays))))


def _seen(
    camera: Camera,
    rays: Float64[Tensor, "n 3"],
    depth: Float64[Tensor, "a b"],
    loose: Bool[Tensor, "a b"],
    nearest: Sequence[View],
    kept: TensorCache,
    before: Bool[Tensor, "a b"],
) -> Bool[Tensor, "a b"]:
    """The answer along each ray; whatever stands before it where it is loose. True where it was before."""
    z, free, seen = depth.reshape(-1), loose.reshape(-1), before.reshape(-1).clone()
    world = camera.centre.double() + rays * z[:, None]
    for one in nearest:
        left = torch.where(~seen)[0]
        if not len(left):
            break
        at, far = project_points(one.camera, world[left])
        size = at.new_tensor([one.camera.width, one.camera.height])
        inside = torch.where((far > one.camera.near) & ((at >= 0) & (at < size)).all(dim=1))[0]
        if one.load_mask is not None and len(inside):
            counted = kept.get((one.name, "mask"), one.load_mask)
            inside = inside[counted[*at[inside].long().T.flip(0)]]
        if not len(inside):
            continue
        shown = free[left[inside]]
        if not shown.all():
            low, high = kept.get(one.name, partial(_bounds, one))[:, *at[inside].long().T.flip(0)]
            shown = shown | ((far[inside] >= low) & (far[inside] <= high))
        seen[left[inside]] = shown
    return seen.reshape(depth.shape)


def _rays(camera: Camera, step: int, shape: torch.Size) -> Float64[Tensor, "n 3"]:
    """Directions in the world, of z-depth 1, of the pixels that are looked at, row-major."""
    y, x = torch.meshgrid(
        torch.arange(shape[0], dtype=torch.float64) * step + 0.5,
        torch.arange(shape[1], dtype=torch.float64) * step + 0.5,
        indexing="ij",
    )
    pixels = torch.stack([x, y, torch.ones_like(x)], dim=2).reshape(-1, 3)
    return pixels @ torch.linalg.inv(camera.K.double()).T @ camera.rotation.double()


def _bounds(view: View) -> Float[Tensor, "2 h w"]:
    """Nearest and farthest true depth around each pixel, widened by SLACK."""
    assert view.load_depth is not None
    depth = view.load_depth()[None]
    low = -max_pool2d(-depth.clamp(max=FAR), 3, stride=1, padding=1)
    high = max_pool2d(depth, 3, stride=1, padding=1)
    return torch.cat([low * (1 - SLACK), high * (1 + SLACK)])


def _sparse_depth(
    camera: Camera, points: SparsePoints, number: int, step: int
) -> Float64[Tensor, "a b"] | None:
    """Depth between the sparse points of a view: linear in disparity, beyond them the nearest one's."""
    positions = points.positions[_of_view(points, number)]
    at, z = project_points(camera, positions)
    size = at.new_tensor([camera.width, camera.height])
    inside = (z > camera.near) & ((at >= 0) & (at < size)).all(dim=1)
    if int(inside.sum()) < FEWEST:
        return None
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator  # slow to import

    where, disparity = at[inside].numpy(), 1 / z[inside].numpy()
    # the points are far sparser than pixels: a small picture of them is enlarged
    small = tuple(min(MOST_CELLS, length) for length in (camera.width, camera.height))
    x, y = (
        (np.arange(count) + 0.5) * length / count
        for count, length in zip(small, (camera.width, camera.height), strict=True)
    )
    cells = np.meshgrid(x, y)
    try:
        between = LinearNDInterpolator(where, disparity)(*cells)
    except QhullError:  # all on one line of the image: nothing lies between them
        between = np.full(cells[0].shape, np.nan)
    beyond = NearestNDInterpolator(where, disparity)(*cells)
    picture = np.where(np.isfinite(between), between, beyond)
    whole = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
    return torch.from_numpy(1 / whole[::step, ::step])


def _of_view(points: SparsePoints, number: int) -> Bool[Tensor, " n"]:
    """The points that a view's own photo shows; all where tracks name too few of them."""
    counts = points.track_starts.diff()
    owner = torch.repeat_interleave(torch.arange(len(points)), counts)
    own = torch.zeros(len(points), dtype=torch.bool)
    own[owner[points.track_views == number]] = True
    return own if int(own.sum()) >= FEWEST else torch.ones_like(own)


def _enlarged(seen: Bool[Tensor, "a b"], step: int, size: tuple[int, int]) -> Bool[Tensor, "h w"]:
    whole = seen.repeat_interleave(step, dim=0).repeat_interleave(step, dim=1)
    return whole[: size[0], : size[1]]
