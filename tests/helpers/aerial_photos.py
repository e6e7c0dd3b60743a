"""Small overlapping photos that features can be found in: views of a random relief, with EXIF."""

from pathlib import Path

import cv2
import numpy as np
from PIL import ExifTags, Image, TiffImagePlugin

METRES_PER_DEGREE = 111_194.9
"""Of latitude, on a sphere of 6,371 km: near enough for a flight of 100 m."""


def texture(seed: int, side: int = 900) -> np.ndarray:
    """8-bit colour noise of many scales with blobs: many distinct corners."""
    rng = np.random.default_rng(seed)
    image = np.zeros((side, side, 3), dtype=np.float32)
    for cells in (12, 30, 75, 180, 400):
        noise = rng.uniform(0, 1, (cells, cells, 3)).astype(np.float32)
        image += cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC) / 5
    for _ in range(400):
        centre = rng.integers(0, side, 2).tolist()
        cv2.circle(image, centre, int(rng.integers(2, 9)), rng.uniform(0, 1, 3).tolist(), -1)
    return np.clip(255 * image, 0, 255).astype(np.uint8)


def aerial_photo(
    ground: np.ndarray, east: float, north: float, size: tuple[int, int]
) -> np.ndarray:
    """What a camera at height 40 above two terraces sees, looking down with the focal of `size`.

    The ground spans 90 x 90 metres around 0, 0. Its eastern half of every 30 m is 8 m higher: two
    homographies, painted far to near, so that the scene is no plane.
    """
    width, height = size
    focal = 0.9 * width
    result = np.zeros((height, width, 3), dtype=np.uint8)
    scale = 90 / len(ground)
    columns = (np.arange(len(ground)) * scale) % 30 >= 15
    for terrace, altitude in ((~columns, 0.0), (columns, 8.0)):
        depth = 40 - altitude
        # texel (u, v) -> metres east = u s - 45, north = 45 - v s -> pixel
        homography = np.array(
            [
                [focal * scale / depth, 0, focal * (-45 - east) / depth + width / 2],
                [0, focal * scale / depth, focal * (north - 45) / depth + height / 2],
                [0, 0, 1],
            ]
        )
        painted = np.dstack(
            [
                ground * terrace[None, :, None],
                255 * np.broadcast_to(terrace, ground.shape[:2]).astype(np.uint8),
            ]
        )
        seen = cv2.warpPerspective(painted, homography, size, flags=cv2.INTER_AREA)
        result = np.where(seen[..., 3:] > 127, seen[..., :3], result)
    return result


def save_photo(
    path: Path, pixels: np.ndarray, gps: tuple[float, float, float] | None = None
) -> None:
    """Write a JPEG, with (east, north, up) metres from 46 N 91 W as its GPS position."""
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "splatproof"
    if gps is not None:
        east, north, up = gps
        latitude = 46 + north / METRES_PER_DEGREE
        longitude = 91 - east / (METRES_PER_DEGREE * np.cos(np.radians(46)))
        tags = exif.get_ifd(ExifTags.IFD.GPSInfo)
        tags[ExifTags.GPS.GPSLatitudeRef] = "N"
        tags[ExifTags.GPS.GPSLatitude] = _sexagesimal(latitude)
        tags[ExifTags.GPS.GPSLongitudeRef] = "W"
        tags[ExifTags.GPS.GPSLongitude] = _sexagesimal(longitude)
        tags[ExifTags.GPS.GPSAltitudeRef] = b"\0"
        tags[ExifTags.GPS.GPSAltitude] = TiffImagePlugin.IFDRational(round(1000 * (300 + up)), 1000)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, quality=95, exif=exif)


def _sexagesimal(degrees: float) -> tuple:
    whole = int(degrees)
    minutes = int((degrees - whole) * 60)
    seconds = (degrees - whole - minutes / 60) * 3600
    rational = TiffImagePlugin.IFDRational
    return rational(whole, 1), rational(minutes, 1), rational(round(seconds * 1_000_000), 1_000_000)


PLACES = [(-9.0, -7.0), (0.5, -7.5), (10.0, -6.5), (-10.0, 2.0), (0.0, 2.5), (9.5, 2.0)]
"""East, north of a small flight."""


def write_flight(
    folder: Path, *, gps: bool = True, size: tuple[int, int] = (400, 300), seed: int = 0
) -> Path:
    """Six photos of a flight at 40 m, in two strips."""
    ground = texture(seed)
    for i, (east, north) in enumerate(PLACES):
        where = (east, north, 40.0) if gps else None
        save_photo(folder / f"air_{i}.jpg", aerial_photo(ground, east, north, size), where)
    return folder
