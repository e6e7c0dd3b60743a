"""The container of .sog: a zip of lossless WebP images and meta.json, checked before it is unpacked."""

import io
import json
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from splatproof.base.errors import DataError
from splatproof.base.files import size_of, whole_file
from splatproof.base.memory import check_growth, check_room

META = "meta.json"
LONGEST_META = 2**20
"""Bytes of meta.json at the most; three codebooks take some 15,000."""
MOST_SIDE = 16_383
"""Pixels along a side of a WebP image at the most (RFC 9649, Section 3.4)."""
FIRST_YEAR = (1980, 1, 1, 0, 0, 0)
"""The time that all files of a bundle have: zip's earliest, so that the same model gives the same bytes."""
UNIX = 3
"""What made the bundle, to zip: the same on every machine."""
PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Ways in which a file of a bundle may be packed."""
CHUNK, SIZE = struct.Struct("<4sI"), struct.Struct("<I")
LOSSLESS, SIGNATURE = b"VP8L", 0x2F
"""Name and first byte of the chunk that holds a lossless image (RFC 9649, Section 3.4)."""
UNLIKELY = 2**24
"""Bytes up to which nobody asks how a bundle grew: an image of one colour takes next to no bytes, and a reader of
so many takes a fraction of a second."""
DAMAGED = (
    zipfile.BadZipFile, zlib.error, EOFError, OSError, struct.error, cv2.error, MemoryError,
    RuntimeError,  # zipfile's words where a password or a newer zip is wanted; RecursionError of deep JSON
    ValueError, KeyError, IndexError, TypeError, OverflowError,  # what meta.json says, and headers that lie
)  # fmt: skip
"""What the readers of zip, JSON and WebP say of bundles that are cut short or garbled."""


def sides(count: int) -> tuple[int, int]:
    """Width and height in pixels of an image of one pixel a Gaussian: multiples of 4, about as high as wide.

    Args:
        count: Number of Gaussians, at least 1.

    Source: the format's public description (PlayCanvas, SOG version 2).
    """
    width = math.ceil(math.sqrt(count) / 4) * 4
    return width, math.ceil(count / width / 4) * 4


def webp(columns: UInt8[np.ndarray, "n c"], width: int, height: int) -> bytes:
    """A lossless WebP image, filled row by row; what is left at its end is 0.

    Pillow writes it because cv2 loses the colours of pixels whose fourth channel is 0, which are labels here.
    Pillow's usual effort: 100 in place of 80, or method 6 in place of 4, took 3 and 100 times as long for less than
    1 in 1,000 of the bytes (positions and scales of 24,440 trained Gaussians).

    Args:
        columns: Three or four values of each pixel.
        width: Pixels.
        height: Pixels.
    """
    channels = columns.shape[1]
    image = np.zeros((height * width, channels), dtype=np.uint8)
    image[: len(columns)] = columns
    file = io.BytesIO()
    Image.fromarray(image.reshape(height, width, channels)).save(
        file, "WEBP", lossless=True, exact=True
    )
    return file.getvalue()


def write_bundle(path: Path, meta: Mapping[str, Any], images: Mapping[str, bytes]) -> None:
    """Write a zip of meta.json and images, not packed further and without times.

    Args:
        path: The file, written whole or not at all.
        meta: What meta.json holds.
        images: WebP images by name.
    """
    text = json.dumps(meta, separators=(",", ":"), allow_nan=False).encode()
    with whole_file(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name, content in ({META: text} | dict(images)).items():
            info = zipfile.ZipInfo(name, date_time=FIRST_YEAR)
            info.create_system = UNIX
            archive.writestr(info, content)


@dataclass(frozen=True)
class Picture:
    """A lossless WebP image that is not decoded yet."""

    name: str
    width: int
    """Pixels."""
    height: int
    chunk: bytes
    """Its one chunk; what a file may hold beside (colour profiles, photo data) is left out."""

    def pixels(self) -> UInt8[np.ndarray, "n 4"]:
        """Red, green, blue and alpha of each pixel, row by row; alpha is 255 where the image has none.

        Raises: ValueError where the image is damaged.
        """
        padded = self.chunk + bytes(len(self.chunk) % 2)
        body = b"WEBP" + CHUNK.pack(LOSSLESS, len(self.chunk)) + padded
        data = np.frombuffer(b"RIFF" + SIZE.pack(len(body)) + body, dtype=np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        if image is None or image.shape[:2] != (self.height, self.width):
            raise ValueError(f"{self.name} is damaged")
        turn = cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGBA
        return cv2.cvtColor(image, turn).reshape(-1, 4)


@dataclass(frozen=True)
class Bundle:
    """An open .sog file."""

    path: Path
    archive: zipfile.ZipFile
    size: int
    """Bytes of the file."""

    def meta(self) -> dict[str, Any]:
        """What meta.json says.

        Raises: DataError where it is none or too long.
        """
        if self.archive.getinfo(META).file_size > LONGEST_META:
            raise DataError(f"{self.path}: {META} of more than {LONGEST_META} bytes")
        found = json.loads(self._read(META))
        if not isinstance(found, dict):
            raise DataError(f"{self.path}: {META} is {type(found).__name__}, expected an object")
        return found

    def picture(self, name: object) -> Picture:
        """The image of that name and its size, which is not decoded yet.

        Args:
            name: What meta.json says.
        Raises: DataError for a name that leaves the bundle, a file that is not there and for no lossless WebP.
        """
        if (
            not isinstance(name, str)
            or not name
            or name in (".", "..")
            or set(name) & set("/\\:\0")
        ):
            raise DataError(f"{self.path}: {META} names {name!r}, expected a file of the bundle")
        data = self._read(name)
        if data[:4] != b"RIFF" or data[8:12] != b"WEBP":
            raise DataError(f"{self.path}: {name} begins with {data[:12]!r}, expected a WebP image")
        at = 12
        while at + CHUNK.size <= len(data):
            kind, length = CHUNK.unpack_from(data, at)
            at += CHUNK.size
            if kind == LOSSLESS:
                chunk = data[at : at + length]
                (word,) = SIZE.unpack_from(chunk, 1)
                if chunk[0] != SIGNATURE or len(chunk) < length:
                    break
                return Picture(name, (word & 0x3FFF) + 1, (word >> 14 & 0x3FFF) + 1, chunk)
            at += length + length % 2
        raise DataError(f"{self.path}: {name} holds no whole lossless image")

    def check(self, pictures: Mapping[str, Picture], numbers: int) -> None:
        """Refuse what does not fit into memory, or is more than such a file can hold, before it is decoded.

        Args:
            pictures: All images, by what they are.
            numbers: Numbers of the Gaussians, in float32.
        Raises: DataError, or MissingError where memory is short.
        """
        pixels = sum(one.width * one.height for one in pictures.values())
        largest = max(one.width * one.height for one in pictures.values())
        check_growth(self.path, 4 * max(pixels, numbers), self.size, small=UNLIKELY)
        # two copies of an image while it is decoded, and three of the numbers: as decoded, put together, checked
        check_room(self.path, self.size + 8 * largest + 12 * numbers)

    def _read(self, name: str) -> bytes:
        """A file of the bundle, no longer than the bundle says it is.

        Raises: DataError where it is not there, packed in another way, or longer than what holds it can be.
        """
        try:
            info = self.archive.getinfo(name)
        except KeyError:
            raise DataError(f"{self.path}: no {name} in it; get the file again") from None
        if info.compress_type not in PACKED:
            raise DataError(
                f"{self.path}: {name} is packed in way {info.compress_type}, expected {PACKED}"
            )
        check_growth(self.path, info.file_size, self.size, small=UNLIKELY)
        check_room(self.path, info.file_size)
        with self.archive.open(info) as file:
            return file.read(info.file_size)  # a number bounds what is unpacked


@contextmanager
def opened(path: Path) -> Iterator[Bundle]:
    """A .sog file, open.

    Args:
        path: The file.
    Raises: DataError where it is missing or damaged, also for what is raised of DAMAGED within the block.
    """
    size = size_of(path)
    try:
        with zipfile.ZipFile(path) as archive:
            yield Bundle(path, archive, size)
    except DAMAGED as error:
        said = str(error) or type(error).__name__
        raise DataError(f"{path}: not a whole .sog file ({said})") from None
