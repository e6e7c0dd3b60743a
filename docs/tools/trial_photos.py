"""Three folders of photos as a stranger brings them: JPEG with EXIF and nothing else, ray-cast from made worlds.

python docs/tools/trial_photos.py FOLDER

No pose, no point and no truth is written: structure from motion has to find what it needs in the photos.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from PIL import ExifTags, Image

from splatproof.base.files import whole_file
from splatproof.datasets.procedural import aerial, courtyard, street_still
from splatproof.datasets.procedural.daylight import Daylight, Sky
from splatproof.datasets.procedural.flights import looking, ring, strips
from splatproof.datasets.procedural.plan import Stage, object_seeds
from splatproof.datasets.procedural.ray_images import shade, strata
from splatproof.datasets.procedural.surface import to_srgb
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.world import World
from splatproof.reference.types.camera import Camera

SENSOR_NOISE = 1.2
"""Standard deviation of each channel in steps of 8 bits: a phone's photo by day."""
SAMPLES = 2
"""Rays a pixel on each axis."""
QUALITY = 92
"""Of the JPEG, as phones write them."""
HOME = (47.3769, 8.5417, 408.0)
"""Latitude and longitude in degrees and altitude in metres of a world's origin: any place will do."""
METRES_A_DEGREE = 111_320.0
"""Of latitude, on a sphere; good to 0.5 %."""


@dataclass(frozen=True, kw_only=True)
class Device:
    """What took a photo."""

    make: str
    model: str
    size: tuple[int, int]
    """Width and height in pixels, as the sensor lies."""
    wide: float
    """Focal length over the width: focal length in 35 mm equivalents over 36."""
    located: bool = False
    """Whether it writes where it is."""


@dataclass(frozen=True, kw_only=True)
class Photo:
    """One photo that is to be taken."""

    name: str
    camera: Camera
    device: Device
    upright: bool = False
    """Held upright: stored as the sensor lies, with an orientation in EXIF, as phones do."""


DRONE = Device(make="Made", model="Drone", size=(960, 720), wide=0.78, located=True)
PHONE = Device(make="Made", model="Phone", size=(960, 720), wide=0.74)
COMPACT = Device(make="Made", model="Compact", size=(900, 600), wide=0.92)
Place = tuple[np.ndarray, np.ndarray]


def _camera(place: Place, device: Device, *, upright: bool = False) -> Camera:
    """What `device` sees; upright: width and height are exchanged, the focal length stays."""
    width, height = device.size
    return looking(*place, (height, width) if upright else (width, height), device.wide * width)


def town() -> tuple[Callable[[], Stage], list[Photo]]:
    """Blocks of houses from the air: two lines straight down and a ring of oblique views."""
    rng = np.random.Generator(np.random.PCG64(21))
    stage = _lit(
        lambda: aerial.SCENES["town"](3), Sky(azimuth=0.7, elevation=0.85), 75.0, 40.0, 3.0
    )
    places = strips((-28.0, 28.0, 4), (-14.0, 14.0, 2), 75.0, 0.06, 0.8, rng)
    places += ring(14, 62.0, 55.0, np.array([0.0, 0.0, 4.0]), 0.2, 0.8, rng)
    return stage, [
        Photo(name=f"DJI_{index + 1:04d}.JPG", camera=_camera(place, DRONE), device=DRONE)
        for index, place in enumerate(places)
    ]


def yard() -> tuple[Callable[[], Stage], list[Photo]]:
    """A walk through a farmyard with a phone, every third photo upright."""
    rng = np.random.Generator(np.random.PCG64(22))
    stage = _lit(lambda: courtyard.build(5), Sky(azimuth=-0.4, elevation=0.7), 32.0, 13.0, 1.25)
    arcs = [(10.0, angle) for angle in np.linspace(-115, -60, 14)]
    arcs += [(7.0, angle) for angle in np.linspace(-75, -125, 10)]
    photos = []
    for index, (radius, degrees) in enumerate(arcs):
        way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
        eye = np.array([-1.0, 3.0, 1.65]) + radius * way + rng.normal(0, 0.08, 3)
        place = (eye, np.array([-1.5, 4.0, 2.2]) + rng.normal(0, 0.25, 3))  # towards the house
        upright = index % 3 == 2
        photos.append(
            Photo(name=f"IMG_20260614_{101500 + 4 * index}.jpg", device=PHONE, upright=upright,
                  camera=_camera(place, PHONE, upright=upright))
        )  # fmt: skip
    return stage, photos


def street() -> tuple[Callable[[], Stage], list[Photo]]:
    """Houses across a street, from its pavement, by two people with cameras of two sizes."""
    rng = np.random.Generator(np.random.PCG64(23))
    stage = _lit(
        lambda: street_still.build(4, 80.0).build(),
        Sky(azimuth=1.2, elevation=0.8),
        60.0,
        20.0,
        1.5,
    )
    photos = []
    for device, count, first, last, y, turn in (
        (PHONE, 14, -4.0, 24.0, -7.6, -4.0),
        (COMPACT, 10, 22.0, -2.0, -8.8, 3.0),
    ):
        for index, along in enumerate(np.linspace(first, last, count)):
            eye = np.array([along, y, 1.65]) + rng.normal(0, 0.1, 3)
            target = np.array([along + turn + rng.normal(0, 0.5), 10.0, 4.0])
            name = f"{device.model[0]}{1000 + index}.jpg"
            photos.append(Photo(name=name, device=device, camera=_camera((eye, target), device)))
    return stage, photos


SETS: dict[str, Callable[[], tuple[Callable[[], Stage], list[Photo]]]] = {
    "yard": yard,
    "street": street,
    "town": town,
}


def _lit(
    build: Callable[[], World], sky: Sky, reach: float, top: float, cell: float
) -> Callable[[], Stage]:
    """A world by day, built when it is asked for; light reaches `reach` metres out and `top` up."""

    def stage() -> Stage:
        world = build()
        caster = Caster(world)
        light = Daylight(caster, sky, (-reach, -reach, -3.0), (reach, reach, top), cell)
        return Stage(caster=caster, lighting=light, object_seeds=object_seeds(len(world.kinds), 0))

    return stage


def take(stage: Stage, photo: Photo, seed: int) -> Image.Image:
    """The picture of a photo, as its sensor stores it.

    Args:
        stage: The lit world.
        photo: What is taken.
        seed: Decides rays and noise.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    camera, rows = photo.camera, []
    for top in range(0, camera.height, 16):
        count = min(16, camera.height - top)
        pixels = strata(camera.width, top, count, SAMPLES, rng)
        colour = shade(stage.caster, stage.lighting, camera, pixels, SAMPLES, stage.object_seeds)
        rows.append(colour.reshape(count, camera.width, SAMPLES**2, 3).mean(dim=2))
    encoded = to_srgb(torch.cat(rows)).numpy() * 255
    noisy = (encoded + rng.normal(0, SENSOR_NOISE, encoded.shape)).round().clip(0, 255)
    if photo.upright:  # the phone is turned a quarter clockwise: its sensor's top is at the right
        noisy = np.rot90(noisy)
    return Image.fromarray(np.ascontiguousarray(noisy.astype(np.uint8)))


def exif(photo: Photo) -> Image.Exif:
    """What the device writes beside the pixels: its name, focal length, orientation and, if it knows, place."""
    tags = Image.Exif()
    tags[ExifTags.Base.Make], tags[ExifTags.Base.Model] = photo.device.make, photo.device.model
    tags[ExifTags.Base.Orientation] = 6 if photo.upright else 1
    details = tags.get_ifd(ExifTags.IFD.Exif)
    details[ExifTags.Base.FocalLengthIn35mmFilm] = round(36 * photo.device.wide)
    details[ExifTags.Base.FocalLength] = round(6 * photo.device.wide, 2)
    if photo.device.located:
        tags.get_ifd(ExifTags.IFD.GPSInfo).update(_gps(photo.camera.centre.numpy()))
    return tags


def _gps(metres: np.ndarray) -> dict[int, object]:
    """GPS tags of a place east, north and above HOME."""
    latitude = HOME[0] + metres[1] / METRES_A_DEGREE
    longitude = HOME[1] + metres[0] / METRES_A_DEGREE / np.cos(np.radians(HOME[0]))
    return {
        ExifTags.GPS.GPSLatitudeRef: "N",
        ExifTags.GPS.GPSLatitude: _sexagesimal(latitude),
        ExifTags.GPS.GPSLongitudeRef: "E",
        ExifTags.GPS.GPSLongitude: _sexagesimal(longitude),
        ExifTags.GPS.GPSAltitude: float(HOME[2] + metres[2]),
    }


def _sexagesimal(degrees: float) -> tuple[float, float, float]:
    exact = Fraction(degrees)
    whole, minutes = int(exact), int(exact % 1 * 60)
    return float(whole), float(minutes), float((exact % 1 * 60 - minutes) * 60)


def make(name: str, folder: Path) -> None:
    """Write the photos of a set that are not there yet.

    Args:
        name: Of SETS.
        folder: Where they go.
    """
    build, photos = SETS[name]()
    missing = [index for index, photo in enumerate(photos) if not (folder / photo.name).exists()]
    if not missing:
        return
    folder.mkdir(parents=True, exist_ok=True)
    stage = build()
    for index in missing:
        with whole_file(folder / photos[index].name) as part:
            picture = take(stage, photos[index], index)
            picture.save(part, format="JPEG", quality=QUALITY, exif=exif(photos[index]))


if __name__ == "__main__":
    for one in SETS:
        make(one, Path(sys.argv[1]) / one)
