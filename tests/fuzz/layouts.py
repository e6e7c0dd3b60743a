"""Kinds of files, each taken apart and put together again with its lengths and checksums made right.

Without this nearly every change ends at the first checksum, and what lies behind it is never tried.
"""

import gzip
import json
import random
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from io import BytesIO

import zstandard
from PIL import Image

from fuzz.layout import Layout, Part
from fuzz.mutations import Change, changed_bytes, changed_json, changed_text
from splatproof.methods.storage.packed.coded_chunk import PARTS as CODED_PARTS
from splatproof.methods.storage.packed.records import CODED as CODED_VERSION
from splatproof.methods.storage.packed.records import LENGTH, START, RecordWriter, split_streams
from splatproof.methods.storage.packed.writer import PARTS
from splatproof.reference.compression import container


def _split_ply(data: bytes) -> list[Part]:
    end = data.index(b"end_header\n") + len(b"end_header\n")
    body = changed_text if b"format ascii" in data[:end] else changed_bytes
    return [(changed_text, data[:end]), (body, data[end:])]


PLY = Layout(_split_ply, b"".join)
"""Header as text, then the body; the header's counts are what it says."""


def _split_png(data: bytes) -> list[Part]:
    parts, at = [], 8
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, content = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if kind == b"IDAT":
            content = zlib.decompress(content)
        parts.append((changed_bytes, kind + content))
        at += 12 + length
    return parts


def _join_png(contents: list[bytes]) -> bytes:
    out = [b"\x89PNG\r\n\x1a\n"]
    for part in contents:
        kind, content = part[:4], part[4:]
        if kind == b"IDAT":
            content = zlib.compress(content)
        out += [
            struct.pack(">I", len(content)),
            kind,
            content,
            struct.pack(">I", zlib.crc32(kind + content)),
        ]
    return b"".join(out)


PNG = Layout(_split_png, _join_png)
"""Chunks with right lengths and CRCs, pixels inflated."""


def _split_glb(data: bytes) -> list[Part]:
    (size,) = struct.unpack_from("<I", data, 12)
    return [(changed_json, data[20 : 20 + size]), (changed_bytes, data[28 + size :])]


def _join_glb(contents: list[bytes]) -> bytes:
    text, body = contents[0] + b" " * (-len(contents[0]) % 4), contents[1]
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    return (
        head
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(body), b"BIN\0")
        + body
    )


GLB = Layout(_split_glb, _join_glb)


def _split_tensors(data: bytes) -> list[Part]:
    (size,) = struct.unpack_from("<Q", data)
    return [(changed_json, data[8 : 8 + size]), (changed_bytes, data[8 + size :])]


SAFETENSORS = Layout(
    _split_tensors, lambda contents: struct.pack("<Q", len(contents[0])) + contents[0] + contents[1]
)

GZIP = Layout(
    lambda data: [(changed_bytes, gzip.decompress(data))],
    lambda contents: gzip.compress(contents[0], 1, mtime=0),
)


def _split_packed(data: bytes) -> list[Part]:
    """Header, lattice, then per chunk and stream how it is coded and what it holds."""
    contents, at = [], START.size
    while at < len(data):
        (length,) = LENGTH.unpack_from(data, at)
        at += LENGTH.size + 32
        contents.append(data[at : at + length])
        at += length
    parts: list[Part] = [(changed_json, contents[0]), (changed_bytes, contents[1])]
    for chunk in contents[2:]:
        at = 0
        for _ in PARTS:
            (length,) = struct.unpack_from("<I", chunk, at)
            stream = chunk[at + 4 : at + 4 + length]
            body = stream[1:]
            if stream[0] & 4:
                body = zstandard.ZstdDecompressor().decompress(body)
            parts.append((changed_bytes, stream[:1] + body))
            at += 4 + length
    return parts


def _join_packed(contents: list[bytes]) -> bytes:
    file = BytesIO()
    writer = RecordWriter(file)
    for content in contents[:2]:
        writer.add(content)
    streams = []
    for part in contents[2:]:
        how, body = part[:1], part[1:]
        if how and how[0] & 4:
            body = zstandard.ZstdCompressor(level=1).compress(body)
        streams.append(struct.pack("<I", len(how + body)) + how + body)
    for first in range(0, len(streams), len(PARTS)):
        writer.add(b"".join(streams[first : first + len(PARTS)]))
    return file.getvalue()


PACKED = Layout(_split_packed, _join_packed)
"""Records with right seals, streams unpacked."""


def _split_coded(head: int) -> Callable[[bytes], list[Part]]:
    """Header, then per chunk and stream what it holds; zstd comes after `head` bytes, or never (0)."""

    def split(data: bytes) -> list[Part]:
        contents, at = [], START.size
        while at < len(data):
            (length,) = LENGTH.unpack_from(data, at)
            at += LENGTH.size + 32
            contents.append(data[at : at + length])
            at += length
        parts: list[Part] = [(changed_json, contents[0])]
        for chunk in contents[1:]:
            for place, stream in enumerate(split_streams(chunk, len(CODED_PARTS))):
                before = head - (place == 0)
                if head and stream[before - 1] & 4:
                    stream = stream[:before] + zstandard.ZstdDecompressor().decompress(
                        stream[before:]
                    )
                parts.append((changed_bytes, stream))
        return parts

    return split


def _join_coded(head: int) -> Callable[[list[bytes]], bytes]:
    def join(contents: list[bytes]) -> bytes:
        file = BytesIO()
        writer = RecordWriter(file, CODED_VERSION)
        writer.add(contents[0])
        streams = []
        for place, stream in enumerate(contents[1:]):
            before = head - (place % len(CODED_PARTS) == 0)
            if head and len(stream) >= before and stream[before - 1] & 4:
                stream = stream[:before] + zstandard.ZstdCompressor(level=1).compress(
                    stream[before:]
                )
            streams.append(struct.pack("<I", len(stream)) + stream)
        for first in range(0, len(streams), len(CODED_PARTS)):
            writer.add(b"".join(streams[first : first + len(CODED_PARTS)]))
        return file.getvalue()

    return join


CODED_SMALL, CODED_FAST = (Layout(_split_coded(head), _join_coded(head)) for head in (0, 2))
"""Version 3 with right seals; in its fast profile with streams unpacked."""


def _split_container(data: bytes) -> list[Part]:
    payload = data[container.HEADER.size :]
    return [
        (changed_bytes, data[4:16]),
        (changed_bytes, zstandard.ZstdDecompressor().decompress(payload)),
    ]


def _join_container(contents: list[bytes]) -> bytes:
    version, degree, packing, count = struct.unpack("<HBBQ", contents[0].ljust(12, b"\0")[:12])
    payload = zstandard.ZstdCompressor(level=1).compress(contents[1])
    fields = (container.MAGIC, version, degree, packing, count, len(payload))
    return container.HEADER.pack(*fields, container._checksum(fields, payload)) + payload


def _split_sog(data: bytes) -> list[Part]:
    with zipfile.ZipFile(BytesIO(data)) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    parts: list[Part] = []
    for name, content in contents.items():
        if name in AS_PIXELS:
            with Image.open(BytesIO(content)) as image:
                content = struct.pack("<H", image.width) + image.convert("RGBA").tobytes()
        head = struct.pack("<B", len(name)) + name.encode()
        parts.append((changed_json if name == "meta.json" else changed_bytes, head + content))
    return [(_behind(change), content) for change, content in parts]


def _behind(change: Change) -> Change:
    """The same for what follows the name of a file."""

    def changed(draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
        at = data[0] + 1
        return data[:at] + change(draw, data[at:], others)

    return changed


def _join_sog(contents: list[bytes]) -> bytes:
    file = BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for part in contents:
            name, content = part[1 : part[0] + 1].decode(), part[part[0] + 1 :]
            if name in AS_PIXELS and len(content) >= 2:
                width = content[0] | (content[1] & 63) << 8
                size = max(width, 1), min(max((len(content) - 2) // 4 // max(width, 1), 1), 16_383)
                pixels = content[2:].ljust(4 * size[0] * size[1], b"\0")[: 4 * size[0] * size[1]]
                image = BytesIO()
                Image.frombytes("RGBA", size, pixels).save(
                    image, "WEBP", lossless=True, exact=True, quality=0, method=0
                )
                content = image.getvalue()
            archive.writestr(zipfile.ZipInfo(name), content)
    return file.getvalue()


AS_PIXELS = ("means_u.webp", "quats.webp", "sh0.webp", "shN_labels.webp")
"""Images whose pixels are changed; of the others it is the file."""
SOG = Layout(_split_sog, _join_sog)
"""Files of a zip with right checksums, some of its images decoded."""


CONTAINER = Layout(_split_container, _join_container)
"""Version 1 of the packed file, with a right checksum."""


def _split_members(data: bytes) -> list[Part]:
    return [(changed_json, data)]


def members(archive: Callable[[list[tuple[str, str, bytes]]], bytes]) -> Layout:
    """Archives written from a list of (name, kind, content), so that names and kinds are tried too.

    Args:
        archive: Writes such a list as an archive.
    """

    def join(contents: list[bytes]) -> bytes:
        try:
            rows = json.loads(contents[0])
            return archive(
                [
                    (str(n), str(kind), str(text).encode("utf-8", "replace"))
                    for n, kind, text in rows
                ]
            )
        except (ValueError, TypeError, RecursionError, OverflowError, struct.error):
            return contents[0]

    return Layout(_split_members, join)
