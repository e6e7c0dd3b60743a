"""What an .spz file says that it holds, checked before any of it is kept in memory."""

import gzip
import struct
import zlib
from pathlib import Path

import zstandard

from splatproof.base.errors import DataError
from splatproof.base.files import CHUNK, size_of
from splatproof.base.memory import check_growth, check_room

GZIP = b"\x1f\x8b"
MAGIC = 0x5053474E
HEAD = struct.Struct("<IIIB3x")
"""Magic, version, number of Gaussians, degree and 3 bytes of other facts: how a file that is
unpacked begins."""
PLAIN = struct.Struct("<IIIB2xBI12x")
"""The same of version 4, which is not packed there: the last of the facts is the number of streams;
then the byte at which their table begins."""
FLAGS = 14
"""Byte of the header, in every version, whose bits say how the model is drawn."""
ENTRY = struct.Struct("<QQ")
"""Bytes of a stream in the file, and unpacked."""
FRAME_HEAD = 18
"""Bytes of the header of a zstd frame, at the most (RFC 8878, Section 3.1.1.1)."""
BANDS = (1, 4, 9, 16)
"""SH coefficients of each degree that is read."""
MOST_EACH = 100
"""Bytes of a Gaussian, at the most: 9 of position, 9 of opacity, colour and scale, 4 of rotation, 45 of
harmonics of degree 3 or 72 of degree 4."""

COPIES = 3
"""Times that the numbers of Gaussians are in memory, at the most: as decoded, harmonics with DC before them, and
what is asked of them, which is measured to take less than as much."""


def check_claims(path: Path) -> None:
    """Refuse a file that does not hold what it says, or that this machine's memory does not.

    Args:
        path: An .spz file of any version.
    Raises: DataError for a file that is missing, cut or made to fill the memory, before more of it is held than
        a few of its bytes; MissingError where the memory that is free is short.

    Source: the format's public description (Niantic Labs, spz); the checks: ours.
    """
    size = size_of(path)
    with path.open("rb") as file:
        head = file.read(PLAIN.size)
    if head.startswith(GZIP):
        unpacked, numbers = _inflated(path)
        room = size + unpacked
    else:
        unpacked, numbers = _announced(path, size, head)
        check_growth(path, 4 * numbers, size)
        room = size + 2 * unpacked  # streams, and all of them one after another
    check_room(path, room + COPIES * 4 * numbers)


def read_flags(path: Path) -> int:
    """The byte of a file's header whose bits say how its model is drawn.

    Args:
        path: An .spz file that `check_claims` let pass.
    Raises: DataError for a file that is missing.

    Source: the format's public description (Niantic Labs, spz).
    """
    size_of(path)
    with path.open("rb") as file:
        packed = file.read(len(GZIP)) == GZIP
        file.seek(0)
        head = gzip.GzipFile(fileobj=file) if packed else file
        return head.read(FLAGS + 1)[FLAGS]


def _inflated(path: Path) -> tuple[int, int]:
    """Bytes that a gzip file unpacks to, and numbers of its Gaussians."""
    unpacked, stream, head = 0, zlib.decompressobj(wbits=31), b""
    try:
        with path.open("rb") as file:
            while chunk := file.read(CHUNK):
                while chunk:
                    part = stream.decompress(chunk, CHUNK)
                    chunk = stream.unconsumed_tail
                    head, unpacked = (head + part)[: HEAD.size], unpacked + len(part)
                    if len(head) == HEAD.size:
                        count = HEAD.unpack(head)[2]
                        if unpacked > HEAD.size + MOST_EACH * count:
                            raise DataError(
                                f"{path}: unpacks to more than its {count} Gaussians can take; "
                                "it is damaged or made to fill the memory, get it again"
                            )
    except zlib.error as error:
        raise _none(path, error) from None
    if len(head) < HEAD.size:
        raise _none(path, f"{unpacked} bytes unpacked, expected {HEAD.size} or more")
    _, version, count, degree = HEAD.unpack(head)
    each = sum(_each(path, version, degree))
    if unpacked < HEAD.size + count * each:
        raise _none(path, f"{unpacked} bytes unpacked, expected {HEAD.size} and {each} for each of "
                          f"{count} Gaussians")  # fmt: skip
    return unpacked, _numbers(count, degree)


def _announced(path: Path, size: int, head: bytes) -> tuple[int, int]:
    """Bytes that the streams of a file of version 4 unpack to, and numbers of its Gaussians."""
    if len(head) < PLAIN.size:
        raise _none(path, f"{size} bytes, expected {PLAIN.size} or more")
    magic, version, count, degree, streams, table = PLAIN.unpack(head)
    if magic != MAGIC or version != 4:
        raise _none(path, f"begins with {head[:8]!r}")
    each = _each(path, version, degree)
    at = table + len(each) * ENTRY.size
    if streams != len(each) or table < PLAIN.size or at > size:
        raise _none(path, f"{streams} streams with a table at byte {table}, expected {len(each)}")
    with path.open("rb") as file:
        file.seek(table)
        entries = list(ENTRY.iter_unpack(file.read(len(each) * ENTRY.size)))
        for number, ((stored, unpacked), one) in enumerate(zip(entries, each, strict=True)):
            file.seek(at)
            try:
                frame = zstandard.frame_content_size(file.read(min(stored, FRAME_HEAD)))
            except zstandard.ZstdError as error:
                raise _none(path, error) from None
            # -1: the frame does not say, and is unpacked up to what the table says
            if unpacked != count * one or frame not in (-1, unpacked) or at + stored > size:
                raise _none(path, f"stream {number} of {stored} bytes unpacks to {unpacked} or {frame}, "
                                  f"expected {one} for each of {count} Gaussians")  # fmt: skip
            at += stored
    return count * sum(each), _numbers(count, degree)


def _each(path: Path, version: int, degree: int) -> list[int]:
    """Bytes of a Gaussian in each stream: position, opacity, colour, scales, rotation, harmonics."""
    if degree >= len(BANDS):
        raise _none(path, f"SH degree {degree}, expected 0 to {len(BANDS) - 1}")
    rest = 3 * (BANDS[degree] - 1)
    return [9, 1, 3, 3, 3 if version < 3 else 4, *([rest] if rest else [])]


def _numbers(count: int, degree: int) -> int:
    """Numbers of so many Gaussians."""
    return count * (11 + 3 * BANDS[degree])


def _none(path: Path, fault: object) -> DataError:
    """The error for what is no .spz file."""
    return DataError(f"{path}: not a whole .spz file ({fault})")
