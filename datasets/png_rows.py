"""Whether a PNG holds all rows of its image: decoders leave those black that are not there."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

CHANNELS = {2: 3, 4: 2, 6: 4}
"""Channels of a PNG by its header's colour type; 1 of the others."""
PASSES = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)
"""First column and row, and steps, of the seven passes of an interlaced image (PNG, Sec. 8.2)."""  # fmt: skip
HEADER = 33
"""Bytes of the signature and of the header's chunk."""
PIECE = 2**20
"""Bytes that are unpacked at a time; nothing of them is kept."""


def lacks_rows(path: Path, image: Image.Image) -> bool:
    """Whether the end of a decoded PNG is made up.

    Rows that are missing are all zeros, so that a last row with anything in it proves that none is; only a
    black one, and the passes of an interlaced image, are counted in the file.

    Args:
        path: File of the image.
        image: The image, decoded.
    """
    with path.open("rb") as file:
        head = file.read(HEADER)
    width, height, depth, colours, _, _, interlaced = struct.unpack(">IIBBBBB", head[16:29])
    if not interlaced and np.asarray(image.crop((0, height - 1, width, height))).any():
        return False
    bits = depth * CHANNELS.get(colours, 1)
    needed = sum(
        high * (1 + (wide * bits + 7) // 8) for wide, high in _passes(width, height, bool(interlaced))
    )  # fmt: skip
    return _unpacked(path, needed) < needed


def _passes(width: int, height: int, interlaced: bool) -> Iterator[tuple[int, int]]:
    """Width and height of each pass that has pixels."""
    if not interlaced:
        yield width, height
        return
    for left, top, across, down in PASSES:
        wide, high = -((left - width) // across), -((top - height) // down)
        if wide > 0 and high > 0:
            yield wide, high


def _unpacked(path: Path, most: int) -> int:
    """Bytes that the image's chunks unpack to, counted up to `most`."""
    stream, count = zlib.decompressobj(), 0
    with path.open("rb") as file:
        file.seek(8)
        while count < most and len(start := file.read(8)) == 8:
            length, kind = struct.unpack(">I4s", start)
            if kind != b"IDAT":
                file.seek(length + 4, 1)
                continue
            left = file.read(length)
            file.seek(4, 1)
            while left and count < most and not stream.eof:
                try:
                    count += len(stream.decompress(left, PIECE))
                except zlib.error:  # what follows damaged bytes is lost
                    return count
                left = stream.unconsumed_tail
    return count
