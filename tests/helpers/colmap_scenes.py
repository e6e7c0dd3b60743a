"""Small COLMAP scenes made by the tests: a flight over a painted plane, photos traced exactly.

The photos follow the camera model from pixel to ray (cam_from_img); loaders go from ray to pixel.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

MODELS: dict[str, list[float]] = {
    "SIMPLE_PINHOLE": [70, 48, 36],
    "PINHOLE": [70, 72, 47, 37],
    "SIMPLE_RADIAL": [70, 48, 36, -0.15],
    "RADIAL": [70, 48, 36, 0.1, -0.05],
    "OPENCV": [70, 71, 46, 37, -0.2, 0.05, 0.004, -0.003],
    "FULL_OPENCV": [70, 71, 48, 36, -0.2, 0.1, 0.002, 0.001, 0.0, 0.01, 0.0, 0.0],
    "FOV": [70, 70, 48, 36, 0.7],
    "SIMPLE_FISHEYE": [70, 48, 36],
    "SIMPLE_RADIAL_FISHEYE": [70, 48, 36, 0.02],
    "OPENCV_FISHEYE": [70, 70, 48, 36, 0.02, -0.01, 0.0, 0.0],
    "THIN_PRISM_FISHEYE": [70, 70, 48, 36, 0.01, 0.0, 0.002, 0.001, 0.0, 0.0, 0.002, 0.001],
    "SIMPLE_DIVISION": [70, 48, 36, -0.1],
    "EUCM": [70, 70, 48, 36, 0.5, 1.1],
}
"""Parameters of many COLMAP models for photos of 96 x 72."""


def pattern(xy: np.ndarray) -> np.ndarray:
    """Smooth colours of the plane z = 0, in [0, 1]."""
    x, y = xy[..., 0], xy[..., 1]
    waves = [np.sin(2.0 * x + 0.5) * np.cos(1.7 * y), np.sin(1.3 * y + x), np.cos(1.9 * x - y)]
    return 0.5 + 0.4 * np.stack(waves, axis=-1)


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What a made scene looks like."""

    views: int = 6
    model: str = "SIMPLE_RADIAL"
    params: list[float] = field(default_factory=lambda: MODELS["SIMPLE_RADIAL"])
    size: tuple[int, int] = (96, 72)
    points: int = 60
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Added to all positions."""
    paint: Callable[[np.ndarray], np.ndarray] = pattern
    seed: int = 0
    lap: int = 1_000_000
    """Views after which the flight begins again at its start."""

    @property
    def camera(self) -> pycolmap.Camera:
        """The one camera of the flight."""
        return pycolmap.Camera(
            camera_id=1,
            model=self.model,
            width=self.size[0],
            height=self.size[1],
            params=self.params,
        )


def pose(flight: Flight, i: int) -> pycolmap.Rigid3d:
    """World to camera of view i: looks down from height 4 with a few degrees of tilt, x to x."""
    i %= flight.lap
    rng = np.random.default_rng([flight.seed, i])
    centre = np.array([0.6 * (i % 3), 0.5 * (i // 3), 4.0]) + flight.offset
    small = pycolmap.Rotation3d(rng.normal(0, 0.04, 3))
    down = np.diag([1.0, -1.0, -1.0])
    rotation = small.matrix() @ down
    return pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)


def trace(flight: Flight, i: int, camera: pycolmap.Camera, pixels: np.ndarray) -> np.ndarray:
    """Positions (x, y) of the plane z = 0 that pixels of view i see, without the offset."""
    plane = np.asarray(camera.cam_from_img(pixels.reshape(-1, 2)))
    rotation = pose(flight, i).rotation.matrix()
    rays = np.concatenate([plane, np.ones((len(plane), 1))], axis=1) @ rotation
    centre = -rotation.T @ pose(flight, i).translation - flight.offset
    hits = centre[:2] - rays[:, :2] * (centre[2] / rays[:, 2:])
    return hits.reshape(pixels.shape)


def pixel_centres(width: int, height: int) -> np.ndarray:
    """Pixel centres (x, y) of an image."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([x, y], axis=-1)


def photo(flight: Flight, i: int) -> np.ndarray:
    """8-bit photo of view i: the colour at each pixel's centre."""
    seen = trace(flight, i, flight.camera, pixel_centres(*flight.size))
    return np.round(255 * flight.paint(seen)).astype(np.uint8)


def view_name(i: int) -> str:
    """Name of view i's photo."""
    return f"photo_{i:03d}.png"


def reconstruction(flight: Flight) -> pycolmap.Reconstruction:
    """The true model: exact observations of random points near the plane."""
    rng = np.random.default_rng(flight.seed)
    model = pycolmap.Reconstruction()
    camera = flight.camera
    model.add_camera_with_trivial_rig(camera)
    low, high = (-2.5, -2.2, 0.0), (3.7, 2.7, 0.3)
    positions = rng.uniform(low, high, (flight.points, 3)) + flight.offset
    tracks: list[list[pycolmap.TrackElement]] = [[] for _ in positions]
    for i in range(flight.views):
        image = pycolmap.Image(name=view_name(i), camera_id=1, image_id=i + 1)
        in_camera = pose(flight, i) * positions
        seen = np.asarray(camera.img_from_cam(in_camera))
        inside = ((seen >= 0) & (seen <= flight.size)).all(axis=1)
        kept = np.flatnonzero(inside)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(seen[k]) for k in kept])
        model.add_image_with_trivial_frame(image, pose(flight, i))
        for place, k in enumerate(kept):
            tracks[k].append(pycolmap.TrackElement(i + 1, place))
    for k, track in enumerate(tracks):
        if len(track) >= 2:
            colour = rng.integers(0, 256, 3).astype(np.uint8)
            model.add_point3D(positions[k], pycolmap.Track(track), colour)
    return model


def write_scene(folder: Path, flight: Flight, *, text: bool = False, rigs: bool = True) -> Path:
    """Write photos and model of a flight as a scene folder; returns the folder."""
    (folder / "photos").mkdir(parents=True)
    (folder / "sparse/0").mkdir(parents=True)
    for i in range(flight.views):
        Image.fromarray(photo(flight, i)).save(folder / "photos" / view_name(i))
    model = reconstruction(flight)
    if text:
        model.write_text(folder / "sparse/0")
    else:
        model.write_binary(folder / "sparse/0")
    if not rigs:
        for path in (folder / "sparse/0").glob("*"):
            if path.stem in ("rigs", "frames"):
                path.unlink()
    return folder
