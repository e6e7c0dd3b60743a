"""Replaces any COLMAP camera by a pinhole: the pinhole's size and K, and where its pixels lie.

Geometry is COLMAP's own camera model in float64; pixels are sampled bilinearly, as COLMAP's
image_undistorter does, so the images equal its images before their 8-bit step.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import grid_sample

from splatproof.base.errors import DataError
from splatproof.datasets.colmap_library import pycolmap

LARGEST = 4
"""With "keep", the pinhole image may be this many times the photo's width or height."""
_PER_SIDE = 33
_ROUND_TRIP = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Undistortion:
    """A photo's camera and the pinhole that replaces it, with the same focal lengths."""

    camera: pycolmap.Camera
    K: Float[Tensor, "3 3"]
    """Intrinsics of the pinhole, float64, in its own pixels."""
    width: int
    height: int
    masked: bool
    """Pixels of the pinhole may lie outside the photo."""


def is_pinhole(camera: pycolmap.Camera) -> bool:
    """Whether the photos can be used as they are. (COLMAP calls an undistorted fisheye that too.)"""
    return camera.is_perspective_pinhole() and camera.is_undistorted()


def plan_undistortion(camera: pycolmap.Camera, rule: str) -> Undistortion:
    """Choose the pinhole of a distorted camera.

    "crop" is COLMAP's rule without blank pixels (proportional about the principal point, at
    most twice the photo's size), then any row or column that still reaches outside the photo
    is cut. "keep" is the smallest image that has the centres of all the photo's pixels.

    Args:
        camera: Perspective camera of any COLMAP model.
        rule: "crop" or "keep".

    Raises: DataError if one pinhole cannot hold the camera's image, or its distortion is
        not invertible there.
    """
    if not camera.is_perspective():
        raise DataError(
            f"camera model {camera.model_name} cannot become one pinhole image; "
            "cut the photos into perspective views first"
        )
    K, width, height = _keep(camera) if rule == "keep" else _crop(camera)
    plan = Undistortion(
        camera=camera, K=torch.from_numpy(K), width=width, height=height, masked=rule == "keep"
    )
    if rule == "crop":
        columns, rows = (np.linspace(0, n - 1, _PER_SIDE) for n in (width, height))
        rays = _rays(K, np.repeat(columns, _PER_SIDE), np.tile(rows, _PER_SIDE))
        if not _invertible(camera, rays).all():
            raise DataError(
                f"distortion of camera model {camera.model_name} with parameters "
                f"{camera.params.tolist()} folds back inside the image; calibrate again"
            )
    return plan


def _crop(camera: pycolmap.Camera) -> tuple[np.ndarray, int, int]:
    options = pycolmap.UndistortCameraOptions()
    options.blank_pixels = 0.0
    pinhole = pycolmap.undistort_camera(options, camera)
    K = pinhole.calibration_matrix()
    left, top, right, bottom = 0, 0, pinhole.width, pinhole.height
    while True:
        columns, rows = np.arange(left, right), np.arange(top, bottom)
        sides = [
            _outside(camera, K, np.full(len(rows), left), rows),
            _outside(camera, K, columns, np.full(len(columns), top)),
            _outside(camera, K, np.full(len(rows), right - 1), rows),
            _outside(camera, K, columns, np.full(len(columns), bottom - 1)),
        ]
        worst = int(np.argmax(sides))
        if sides[worst] == 0:
            break
        left, top = left + (worst == 0), top + (worst == 1)
        right, bottom = right - (worst == 2), bottom - (worst == 3)
        if 2 * (right - left) < pinhole.width or 2 * (bottom - top) < pinhole.height:
            raise DataError(
                f"camera model {camera.model_name} with parameters {camera.params.tolist()} has no "
                "rectangle free of invalid pixels; calibrate again or undistort with 'keep'"
            )
    K[0, 2] -= left
    K[1, 2] -= top
    return K, right - left, bottom - top


def _outside(
    camera: pycolmap.Camera, K: np.ndarray, columns: np.ndarray, rows: np.ndarray
) -> float:
    """Share of pixels whose position in the photo is outside it."""
    return float(1 - _inside(camera, _project(camera, _rays(K, columns, rows))).mean())


def _keep(camera: pycolmap.Camera) -> tuple[np.ndarray, int, int]:
    columns, rows = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    border = np.concatenate(
        [np.stack([columns, np.full_like(columns, y)], 1) for y in (rows[0], rows[-1])]
        + [np.stack([np.full_like(rows, x), rows], 1) for x in (columns[0], columns[-1])]
    )
    plane = _unproject(camera, border)
    rays = np.concatenate([plane, np.ones((len(plane), 1))], axis=1)
    focal = np.array([camera.focal_length_x, camera.focal_length_y])
    low, high = np.floor((plane * focal).min(0) - 0.5), np.ceil((plane * focal).max(0) + 0.5)
    most = LARGEST * np.array([camera.width, camera.height])
    if not (np.isfinite(rays).all() and (high - low <= most).all() and _same(camera, rays, border)):
        raise DataError(
            f"camera model {camera.model_name} with parameters {camera.params.tolist()}: a pinhole "
            f"with all its pixels would exceed {LARGEST} times the photo; undistort with 'crop'"
        )
    K = np.array([[focal[0], 0, -low[0]], [0, focal[1], -low[1]], [0, 0, 1.0]])
    return K, int(high[0] - low[0]), int(high[1] - low[1])


def _project(camera: pycolmap.Camera, rays: np.ndarray) -> np.ndarray:
    """Pixels of points in camera space."""
    return np.asarray(camera.img_from_cam(rays))


def _unproject(camera: pycolmap.Camera, pixels: np.ndarray) -> np.ndarray:
    """Positions on the plane z = 1 of pixels."""
    return np.asarray(camera.cam_from_img(pixels))


def _same(camera: pycolmap.Camera, rays: np.ndarray, pixels: np.ndarray) -> bool:
    return bool(np.abs(_project(camera, rays) - pixels).max() < 1e-3)


def _rays(K: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Points at z = 1 on the rays through the centres of the given pixels."""
    x = (columns + 0.5 - K[0, 2]) / K[0, 0]
    y = (rows + 0.5 - K[1, 2]) / K[1, 1]
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def _inside(camera: pycolmap.Camera, positions: np.ndarray) -> np.ndarray:
    """Whether positions lie on the photo: [0, w] x [0, h] in pixels. NaN does not."""
    size = np.array([camera.width, camera.height])
    return np.logical_and.reduce((positions >= 0) & (positions <= size), axis=-1)


def _invertible(camera: pycolmap.Camera, rays: np.ndarray) -> np.ndarray:
    """Whether the camera model sends rays to pixels that it sends back to the same rays."""
    back = _unproject(camera, _project(camera, rays))
    return np.abs(back - rays[:, :2]).max(-1) < _ROUND_TRIP * (1 + np.abs(rays[:, :2]).max(-1))


def photo_positions(plan: Undistortion) -> Float[Tensor, "h w 2"]:
    """Where in the photo each pixel of the pinhole lies, as (x / w, y / h); NaN: nowhere.

    Float32 of the share of the image: at 10,000 pixels that is 6e-4 of a pixel at most.
    """
    K, camera = plan.K.numpy(), plan.camera
    shares = np.empty((plan.height, plan.width, 2), dtype=np.float32)
    for row in range(plan.height):  # a row at a time: float64 rays of a whole photo are 1 GB
        rays = _rays(K, np.arange(plan.width), np.full(plan.width, row))
        positions = _project(camera, rays)
        valid = _inside(camera, positions)
        if plan.masked:
            valid &= _invertible(camera, rays)
        share = positions / [camera.width, camera.height]
        shares[row] = np.where(valid[:, None], share, np.nan)
    return torch.from_numpy(shares)


def undistort_image(
    image: Float[Tensor, "h w c"], positions: Float[Tensor, "h2 w2 2"]
) -> Float[Tensor, "h2 w2 c"]:
    """Sample a photo bilinearly at positions of `photo_positions`; zeros where they are NaN.

    Within half a pixel of the photo's border the nearest pixel's value holds.

    Args:
        image: The photo, or a smaller copy of it.
        positions: Where each pixel of the pinhole lies, in shares of the photo's width and height.
    """
    grid = (2 * positions - 1).nan_to_num(nan=-9.0)[None]
    sampled = grid_sample(
        image.permute(2, 0, 1)[None], grid, padding_mode="border", align_corners=False
    )[0].permute(1, 2, 0)
    return (sampled * valid_pixels(positions)[..., None]).contiguous()


def valid_pixels(positions: Float[Tensor, "h w 2"]) -> Bool[Tensor, "h w"]:
    """Pixels of the pinhole that lie on the photo."""
    return ~positions.isnan().any(-1)
