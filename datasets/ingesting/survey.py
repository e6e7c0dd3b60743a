"""Looks at every photo once: whether it can be read, its size, camera and GPS position."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from PIL import ExifTags, Image

from splatproof.base.errors import DataError
from splatproof.datasets.ingesting.upright import AS_STORED, QUARTERS, orientation
from splatproof.datasets.photos import PHOTO_SUFFIXES, UNREAD_SUFFIXES, check_photo, list_photos


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A readable photo."""

    path: Path
    name: str
    """Name in the scene: relative to the folder, blanks replaced (COLMAP's pair lists split
    at blanks)."""
    lens: tuple[int, int, str]
    """(width, height, make + model + focal length from EXIF): equal means one shared camera. Width
    and height are those of the scene's copy, which stands as it is looked at."""
    gps: tuple[float, float, float] | None
    """(latitude, longitude in degrees, altitude in metres or nan) from EXIF; None: unknown."""
    turned: bool
    """Whether EXIF says that it is looked at another way than it is stored."""


@dataclass(frozen=True, kw_only=True)
class Survey:
    """All photos of a folder."""

    photos: tuple[Photo, ...]
    """Readable ones, sorted by name."""
    unreadable: dict[str, str]
    """Name: what is wrong with it, or that files of its kind are not read."""

    @property
    def lenses(self) -> list[tuple[int, int, str]]:
        """The distinct cameras, in order."""
        return sorted({photo.lens for photo in self.photos})


def survey_photos(folder: Path, report: Callable[[int, int], None]) -> Survey:
    """Look at every JPEG, PNG and TIFF below a folder; every file is decoded to find damaged ones.

    Args:
        folder: Folder of photos; subfolders count, hidden files do not.
        report: Told (done, total).

    Raises: DataError where there is no folder, no photo, or fewer than two that can be read.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder; give the folder that has the photos")
    files, unread = list_photos(folder), list_photos(folder, UNREAD_SUFFIXES)
    if not files:
        looked = f"looked for {', '.join(PHOTO_SUFFIXES)} files"
        raise DataError(f"{folder}: no photo found; {'; '.join([looked, *_unread(unread)])}")
    photos: dict[str, Photo] = {}
    unreadable: dict[str, str] = {}
    for i, file in enumerate(files):
        report(i, len(files))
        name = re.sub(r"\s", "_", file)
        if name in photos:
            raise DataError(f"{folder / file}: its name becomes {name!r}, which another photo has")
        try:
            check_photo(folder / file)
            photos[name] = _read(folder / file, name)
        except DataError as error:
            unreadable[name] = str(error).removeprefix(f"{folder / file}: ")
    report(len(files), len(files))
    if len(photos) < 2:
        found = "only one photo" if len(files) == 1 else f"{len(photos)} of {len(files)} photos"
        faults = [f"{name} is damaged" for name in [*unreadable][:1]] + _unread(unread)
        why = f" ({'; '.join(faults)})" if faults else ""
        raise DataError(
            f"{folder}: {found} can be used{why}; structure from motion needs at least two, "
            "better ten, that show the same things from different places"
        )
    others = {
        name: f"{Path(name).suffix.lower()} is not read; convert it to JPEG or PNG"
        for name in unread
    }
    return Survey(
        photos=tuple(photos[name] for name in sorted(photos)), unreadable=unreadable | others
    )


def _unread(names: list[str]) -> list[str]:
    """What is said of photos of kinds that are not read, nothing where there are none."""
    if len(names) < 2:
        return [f"{name} is not read; convert it to JPEG or PNG" for name in names]
    return [f"{names[0]} and {len(names) - 1} more are not read; convert them to JPEG or PNG"]


def _read(path: Path, name: str) -> Photo:
    with Image.open(path) as image:
        exif = image.getexif()
        details = exif.get_ifd(ExifTags.IFD.Exif)
        words = [exif.get(ExifTags.Base.Make), exif.get(ExifTags.Base.Model)]
        words += [details.get(ExifTags.Base.FocalLength)]
        text = " ".join(str(word).strip("\0 ") for word in words if word is not None)
        turned = orientation(image)
        width, height = image.size if turned not in QUARTERS else (image.height, image.width)
        return Photo(
            path=path,
            name=name,
            lens=(width, height, text),
            gps=gps_position(exif.get_ifd(ExifTags.IFD.GPSInfo)),
            turned=turned != AS_STORED,
        )


def gps_position(tags: dict) -> tuple[float, float, float] | None:
    """(latitude, longitude, altitude) of EXIF GPS tags; None if they say nothing usable.

    Degrees, north and east positive; metres, below sea level negative, nan where unknown.
    Cameras without a fix write 0, 0 or nan: that is nothing usable.
    """
    try:
        latitude = _degrees(tags[ExifTags.GPS.GPSLatitude])
        longitude = _degrees(tags[ExifTags.GPS.GPSLongitude])
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    south = str(tags.get(ExifTags.GPS.GPSLatitudeRef, "N")).upper().startswith("S")
    west = str(tags.get(ExifTags.GPS.GPSLongitudeRef, "E")).upper().startswith("W")
    if not (abs(latitude) <= 90 and abs(longitude) <= 180) or latitude == longitude == 0:
        return None
    try:
        altitude = float(tags[ExifTags.GPS.GPSAltitude])
        below = tags.get(ExifTags.GPS.GPSAltitudeRef, b"\0") in (b"\1", 1)
        altitude = -altitude if below else altitude
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        altitude = math.nan
    return -latitude if south else latitude, -longitude if west else longitude, altitude


def _degrees(parts: tuple) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    return degrees + minutes / 60 + seconds / 3600
