"""Photo files: which there are, how large they are, and their pixels.

They are 8-bit RGB or grey, or PNG of 16-bit RGB.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8, UInt16
from PIL import ExifTags, Image
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import size_of, write_bytes
from splatproof.base.memory import check_growth, check_room
from splatproof.datasets.png_rows import CHANNELS, lacks_rows

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
UNREAD_SUFFIXES = (
    ".heic", ".heif", ".hif", ".avif", ".webp", ".jxl", ".jp2", ".jfif", ".jpe", ".mpo", ".insp",
    ".bmp", ".gif", ".tga", ".psd", ".exr",
    ".dng", ".raw", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".srf", ".raf", ".orf",
    ".rw2", ".rwl", ".pef", ".srw", ".3fr", ".fff", ".iiq", ".x3f", ".gpr",
)  # fmt: skip
"""Images of telephones, of the web and of cameras as their sensors saw them, none of which is taken for a photo:
who has photos of these kinds is told so."""
PEAK = 32
"""Bytes a pixel while a photo is read, at the most. RGB takes 23: twice 4 in Pillow, 3 as an array, 12 as floats;
what is transparent takes more."""
BITS = {"1": 1, "RGB": 24, "YCbCr": 24, "LAB": 24, "RGBA": 32, "CMYK": 32, "I": 32, "F": 32}
"""Bits a pixel in a file of each of Pillow's modes; 8 of the others, or more."""
SMALL_PNG = 2**16
"""Bytes of pixels up to which a PNG is not asked whether it can hold them."""
MOST_JPEG = 512
"""Pixels a byte of a JPEG at the most: a bit for each block of 8 x 8. What is not there libjpeg makes up."""
MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "La", "RGBa")
"""Pillow's modes that are RGB or grey of 8 bits: they are shown as they are stored."""
BITS_PER_SAMPLE = 258
"""Tag of TIFF."""
# Aerial cameras reach 150 megapixels, above Pillow's limit; ours is the memory, see `_check`.
Image.MAX_IMAGE_PIXELS = None


def list_photos(folder: Path, suffixes: tuple[str, ...] = PHOTO_SUFFIXES) -> list[str]:
    """Names of all photos below a folder, relative to it with "/", sorted; hidden ones left out.

    Args:
        folder: Where to look.
        suffixes: Ends of the names that count, in small letters.
    """
    names = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(
        name.as_posix()
        for name in names
        if name.suffix.lower() in suffixes and not any(part.startswith(".") for part in name.parts)
    )


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image file; everything Pillow can say against it becomes one DataError."""
    if not os.path.lexists(path):
        raise DataError(f"{path}: photo is missing; put it back or leave it out")
    size = size_of(path)
    try:
        with Image.open(path) as image:
            # a damaged header may say any size; what decodes it would allocate that first
            if image.format == "PNG":
                _check_png(path, image.width * image.height, size)
            if image.format == "JPEG" and image.width * image.height > MOST_JPEG * size:
                raise DataError(
                    f"{path}: {size} bytes are too few for a JPEG of {image.width} x {image.height} px; "
                    "replace the file"
                )
            check_growth(path, image.width * image.height * BITS.get(image.mode, 8) // 8, size)
            yield image
    except (
        OSError,
        ValueError,
        SyntaxError,
        IndexError,
        TypeError,
        MemoryError,
        AssertionError,
    ) as error:
        said = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise DataError(f"{path}: not a readable image ({said}); replace the file") from None


def _check_png(path: Path, pixels: int, size: int) -> None:
    """Refuse a PNG whose file cannot hold its pixels: Pillow leaves those black that are not there."""
    with path.open("rb") as file:
        depth, colours = file.read(26)[24:]
    check_growth(path, pixels * depth * CHANNELS.get(colours, 1) // 8, size, small=SMALL_PNG)


def photo_size(path: Path) -> tuple[int, int]:
    """(width, height) from the header alone, as stored: an EXIF orientation is not applied.

    Raises: DataError if the file is missing or is not an image.
    """
    with _opened(path) as image:
        return image.size


def read_photo(
    path: Path,
    background: tuple[float, float, float] | None = None,
    least: tuple[int, int] | None = None,
) -> Float[Tensor, "h w 3"]:
    """Pixels of a photo as float32 sRGB in [0, 1], grey repeated to RGB.

    Values are as stored: k / 255 of 8 bits, k / 65535 of 16 bits.

    The EXIF orientation is not applied: COLMAP does not apply it either, and the camera's size
    and pixels must mean the same.

    Args:
        path: Image file.
        background: sRGB in [0, 1] that transparent pixels are laid on, a c + (1 - a) b in sRGB
            as NeRF and 3DGS do; None: a transparent photo is refused.
        least: (width, height) that is enough: a JPEG is decoded at the least half, quarter or eighth of its size
            that is not below, in a fraction of the time. None: at its own.

    Raises: DataError if the file is missing, cut short, of another pixel format, or transparent.
    """
    with _opened(path) as image:
        drawn = None if least is None else image.draft("RGB", least)
        _check(path, image, transparent=background is not None)
        if background is not None and image.has_transparency_data:
            rgba = torch.from_numpy(np.array(image.convert("RGBA"))).float() / 255
            return rgba[..., :3] * rgba[..., 3:] + torch.tensor(background) * (1 - rgba[..., 3:])
        if _is_16_bit(path):
            # Pillow would drop the lower byte
            stored = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
            if stored is None or stored.shape != (image.height, image.width, 3):
                raise DataError(f"{path}: not a readable image (16-bit PNG); replace the file")
            return torch.from_numpy(stored[..., ::-1].astype(np.float32)).div_(65535)
        pixels = image.convert("RGB")
        if drawn is not None and drawn[1][2:] != image.size:
            # of sides that are no multiples, the last pixels reach beyond the photo: it would be squeezed
            pixels = pixels.resize(image.size, Image.Resampling.BICUBIC, box=drawn[1])
    return torch.from_numpy(np.array(pixels)).float().div_(255)


def _is_16_bit(path: Path) -> bool:
    """Whether the header is that of a PNG of 16-bit RGB (bit depth 16, colour type 2)."""
    with path.open("rb") as file:
        head = file.read(26)
    return head[:8] == b"\x89PNG\r\n\x1a\n" and head[24:] == bytes([16, 2])


def _bits(path: Path, image: Image.Image) -> int:
    """Bits of a channel in the file, where a format has more than 8 and Pillow drops them."""
    if image.format == "PNG":
        with path.open("rb") as file:
            return file.read(25)[24]
    if image.format == "TIFF":
        return max(getattr(image, "tag_v2", {}).get(BITS_PER_SAMPLE, (1,)))
    return 8


def check_photo(path: Path, *, transparent: bool = False) -> None:
    """Raise what `read_photo` would raise; JPEGs are decoded at an eighth of the size.

    Args:
        path: Image file.
        transparent: Whether it may be.
    """
    with _opened(path) as image:
        check_room(path, image.width * image.height * PEAK)
        image.draft("RGB", (max(image.width // 8, 1), max(image.height // 8, 1)))
        _check(path, image, transparent=transparent)


def _check(path: Path, image: Image.Image, *, transparent: bool = False) -> None:
    """Decode, and refuse what is not 8-bit RGB or grey, is transparent where it must not be, or would be turned."""
    turned = image.getexif().get(ExifTags.Base.Orientation, 1)
    if image.format == "TIFF" and turned != 1:  # Pillow turns it while it decodes, COLMAP does not
        raise DataError(
            f"{path}: its orientation is {turned}, which is obeyed in JPEGs alone; save it upright, or "
            "as JPEG"
        )
    bits, mode = _bits(path, image), image.mode
    if mode not in MODES or (bits > 8 and not _is_16_bit(path)):
        depth = f" of {bits} bits" if bits > 8 else ""
        raise DataError(
            f"{path}: pixel format is {mode}{depth}, expected 8-bit RGB or grey, or a PNG of 16-bit "
            "RGB; convert it"
        )
    check_room(path, image.width * image.height * PEAK)
    image.load()
    if image.format == "PNG" and lacks_rows(path, image):
        raise DataError(f"{path}: its last rows are missing; replace the file")
    if transparent or not image.has_transparency_data:
        return
    if np.asarray(image.convert("RGBA"))[..., 3].min() < 255:
        raise DataError(f"{path}: has transparent pixels; flatten it onto a background")


def write_png(path: Path, image: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"]) -> None:
    """Write RGB of 8 or 16 bits as a PNG; a kill leaves the old file or the new one.

    Args:
        path: File to write.
        image: Pixels, h x w x 3.
    """
    done, data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    assert done
    write_bytes(path, data.tobytes())
