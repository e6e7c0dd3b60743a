"""A file of records, one after another, each sealed with all before it: damage is seen on reading.

Layout, little-endian: 4 bytes magic, u16 version, then records: u64 length, 32 bytes SHA-256 of the
seal of the record before (of magic and version, for the first), the length and the content; content.
"""

import hashlib
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from splatproof.base.errors import DataError
from splatproof.reference.compression.container import MAGIC

VERSION = 2
"""Version of files of half-precision and 8-bit numbers (writer); version 1 is
reference.compression.container's."""
CODED = 3
"""Version of files of codes (coded_writer)."""
START = struct.Struct("<4sH")
LENGTH = struct.Struct("<Q")
STREAM = struct.Struct("<I")
SEAL = hashlib.sha256().digest_size
"""Bytes of a seal."""


class RecordWriter:
    """Appends sealed records to an open file."""

    def __init__(self, file: BinaryIO, version: int = VERSION) -> None:
        """Write magic and version.

        Args:
            file: An open file.
            version: VERSION or CODED.
        """
        self._file = file
        self._seal = START.pack(MAGIC, version)
        file.write(self._seal)

    def add(self, content: bytes) -> None:
        """Append one record."""
        length = LENGTH.pack(len(content))
        self._seal = _seal(self._seal, length, content)
        self._file.writelines((length, self._seal, content))


def version_of(path: Path) -> int:
    """Version of a packed file.

    Raises: DataError for a file that is missing or of another kind.
    """
    try:
        with path.open("rb") as file:
            head = file.read(START.size)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    if len(head) < START.size or head[:4] != MAGIC:
        raise DataError(f"{path}: not a packed model: it starts with {head[:4]!r}, not {MAGIC!r}")
    return START.unpack(head)[1]


def records(path: Path) -> Iterator[bytes]:
    """The records of a file of version 2 or 3, each checked before it is given out.

    Raises: DataError where the file was cut, altered or joined with something.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        seal = file.read(START.size)
        while head := file.read(LENGTH.size):
            found = file.read(SEAL)
            length = LENGTH.unpack(head)[0] if len(head) == LENGTH.size else size
            if len(found) < SEAL or length > size - file.tell():
                raise DataError(
                    f"{path}: ends in the middle of a record: it was cut; copy it again"
                )
            content = file.read(length)
            seal = _seal(seal, head, content)
            if seal != found:
                raise DataError(
                    f"{path}: record before byte {file.tell()} has a wrong checksum: the file was "
                    "altered; copy it again"
                )
            yield content


def number_of_records(path: Path) -> int:
    """How many records a file of version 2 or 3 says it has, by their lengths alone; one that is cut counts.

    Args:
        path: The file.
    """
    size, found = path.stat().st_size, 0
    with path.open("rb") as file:
        at = file.seek(START.size)
        while at < size:
            found += 1
            length = LENGTH.unpack(file.read(LENGTH.size).ljust(LENGTH.size, b"\0"))[0]
            at += LENGTH.size + SEAL + length
            file.seek(min(at, size))
    return found


def chunk_records(
    path: Path, stream: Iterator[bytes], count: int, size: int
) -> Iterator[tuple[int, bytes]]:
    """Number of primitives and content of each chunk.

    Args:
        path: The file, for errors.
        stream: Its records after those that are no chunks.
        count: Number of primitives of the file.
        size: Number of primitives of each chunk but the last.
    Raises: DataError where chunks are missing or too many.
    """
    starts = range(0, count, size)
    found = 0
    for found, content in enumerate(stream, start=1):
        if found > len(starts):
            break
        yield min(size, count - starts[found - 1]), content
    if found != len(starts):
        raise DataError(
            f"{path}: {found} chunks or more, expected {len(starts)}: the file was cut or joined"
        )


def split_streams(content: bytes, number: int) -> list[bytes]:
    """The streams of a chunk, each after its length in bytes (u32).

    Args:
        content: The chunk.
        number: How many streams there are.
    Raises: DataError where lengths and content disagree.
    """
    streams, at = [], 0
    for _ in range(number):
        if at + STREAM.size > len(content):
            raise DataError(f"{len(content)} bytes of streams, expected more than {at}")
        (length,) = STREAM.unpack_from(content, at)
        streams.append(content[at + STREAM.size : at + STREAM.size + length])
        at += STREAM.size + length
    if at != len(content):
        raise DataError(f"{len(content)} bytes of streams, expected {at}")
    return streams


def _seal(before: bytes, length: bytes, content: bytes) -> bytes:
    """SHA-256 over everything so far."""
    return hashlib.sha256(before + length + content).digest()
