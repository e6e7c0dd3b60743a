"""Photo files: which there are, how large they are, and their pixels.

They are 8-bit RGB or grey, or PNG of 16-bit RGB.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8, UInt16
from PIL import Image
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import write_bytes

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
# Aerial cameras reach 150 megapixels, above Pillow's default warning against decompression bombs.
Image.MAX_IMAGE_PIXELS = 2**30


def list_photos(folder: Path) -> list[str]:
    """Names of all photos below a folder, relative to it with "/", sorted; hidden ones left out."""
    names = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(
        name.as_posix()
        for name in names
        if name.suffix.lower() in PHOTO_SUFFIXES
        and not any(part.startswith(".") for part in name.parts)
    )


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image file; everything Pillow can say against it becomes one DataError."""
    try:
        with Image.open(path) as image:
            yield image
    except FileNotFoundError:
        raise DataError(f"{path}: photo is missing; put it back or leave it out") from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        said = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise DataError(f"{path}: not a readable image ({said}); replace the file") from None


def photo_size(path: Path) -> tuple[int, int]:
    """(width, height) from the header alone, as stored: an EXIF orientation is not applied.

    Raises: DataError if the file is missing or is not an image.
    """
    with _opened(path) as image:
        return image.size


def read_photo(
    path: Path, background: tuple[float, float, float] | None = None
) -> Float[Tensor, "h w 3"]:
    """Pixels of a photo as float32 sRGB in [0, 1], grey repeated to RGB.

    Values are as stored: k / 255 of 8 bits, k / 65535 of 16 bits.

    The EXIF orientation is not applied: COLMAP does not apply it either, and the camera's size
    and pixels must mean the same.

    Args:
        path: Image file.
        background: sRGB in [0, 1] that transparent pixels are laid on, a c + (1 - a) b in sRGB
            as NeRF and 3DGS do; None: a transparent photo is refused.

    Raises: DataError if the file is missing, cut short, of another pixel format, or transparent.
    """
    with _opened(path) as image:
        _check(path, image, transparent=background is not None)
        if background is not None and image.has_transparency_data:
            rgba = torch.from_numpy(np.array(image.convert("RGBA"))).float() / 255
            return rgba[..., :3] * rgba[..., 3:] + torch.tensor(background) * (1 - rgba[..., 3:])
        if _is_16_bit(path):
            # Pillow would drop the lower byte
            stored = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
            return torch.from_numpy(stored[..., ::-1].astype(np.float32)) / 65535
        pixels = np.array(image.convert("RGB"))
    return torch.from_numpy(pixels).float() / 255


def _is_16_bit(path: Path) -> bool:
    """Whether the header is that of a PNG of 16-bit RGB (bit depth 16, colour type 2)."""
    with path.open("rb") as file:
        head = file.read(26)
    return head[:8] == b"\x89PNG\r\n\x1a\n" and head[24:] == bytes([16, 2])


def check_photo(path: Path) -> None:
    """Raise what `read_photo` would raise; JPEGs are decoded at an eighth of the size."""
    with _opened(path) as image:
        image.draft("RGB", (image.width // 8, image.height // 8))
        _check(path, image)


def _check(path: Path, image: Image.Image, *, transparent: bool = False) -> None:
    """Decode, and refuse what is not 8-bit RGB or grey, or is transparent where it must not be."""
    image.load()
    if image.mode.startswith(("I", "F")):
        raise DataError(f"{path}: pixel format is {image.mode}, expected 8-bit RGB or grey")
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
