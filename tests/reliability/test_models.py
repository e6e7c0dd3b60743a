"""Files of models that are bombs, of wrong types, or none."""

import gzip
import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard

from helpers.tiny_scene import camera, random_gaussians
from splatproof.base import memory
from splatproof.base.errors import DataError, MissingError
from splatproof.base.memory import peak_memory_mb, peak_within
from splatproof.datasets.adapters.ply_points import read_ply_points
from splatproof.datasets.array_files import read_arrays
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.storage.camera_files import read_cameras
from splatproof.methods.storage.packed.coded_writer import write_coded
from splatproof.methods.storage.packed.reader import read_packed, unpack_packed
from splatproof.methods.storage.packed.records import CODED, VERSION, RecordWriter, records
from splatproof.methods.storage.packed.writer import write_packed
from splatproof.methods.storage.ply import read_ply
from splatproof.methods.storage.spz import read_spz, write_spz


def claiming(path: Path, version: int, **changed: int) -> None:
    """A packed file, sealed again, whose header says other numbers."""
    (write_packed if version == VERSION else write_coded)(path, random_gaussians(40, degree=3))
    header, *others = records(path)
    told = json.dumps(json.loads(header) | changed).encode()
    with path.open("wb") as file:
        writer = RecordWriter(file, version)
        for content in (told, *others):
            writer.add(content)


HEADERS = [
    b"[" * 100_000,
    b'{"format": ' + b"[" * 100_000,
    b"null",
    b"[]",
    b"\xff",
    {"shift": [10**400, 0, 0]},
    {"shift": [None, 0, 0]},
    {"shift": [1e999, 0, 0]},
    {"primitives": 10**400},
    {"primitives": -1},
    {"bands": 10**400},
    {"chunk": 0},
    {"format": {}},
    {"mode": []},
]


@pytest.mark.parametrize("changed", HEADERS, ids=lambda one: str(one)[:40])
def test_headers_of_packed_files(tmp_path, changed):
    path = tmp_path / "model.spgs"
    write_packed(path, random_gaussians(40))
    header, *others = records(path)
    told = (
        json.dumps(json.loads(header) | changed).encode() if isinstance(changed, dict) else changed
    )
    with path.open("wb") as file:
        writer = RecordWriter(file)
        for content in (told, *others):
            writer.add(content)
    with pytest.raises(DataError, match=r"model\.spgs: ") as caught:
        read_packed(path)
    assert "\n" not in str(caught.value)


def entry(**changed) -> dict:
    where = camera(0)
    return {"name": "0.png", "width": where.width, "height": where.height,
            "K": where.K.tolist(), "world_to_camera": where.world_to_camera.tolist()} | changed  # fmt: skip


@pytest.mark.parametrize(
    "changed",
    [{"name": name} for name in ("..", ".", "/", "", "a\0", "\ud800", "../../a", "n" * 300)]
    + [
        {side: size}
        for side in ("width", "height")
        for size in (10**5, 2**40, 2**80, 10**400, 1e300)
    ]
    + [{"width": 2**16, "height": 2**16}, {"K": [[10**400] * 3] * 3}, {"time": 10**400}],
    ids=lambda one: str(one)[:50],
)
def test_cameras_that_nothing_can_be_rendered_from(tmp_path, changed, monkeypatch):
    monkeypatch.setattr(memory, "available_mb", lambda: 64_000.0)
    (tmp_path / "cameras.json").write_text(json.dumps([entry(**changed)]))
    with pytest.raises((DataError, MissingError), match=r"cameras\.json: camera 0") as caught:
        read_cameras(tmp_path / "cameras.json")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("version", "changed", "said"),
    [(VERSION, {"primitives": 15_000_000}, r"says that its \d+ bytes hold 3376 MB"),
     (CODED, {"primitives": 15_000_000}, r"claims 15000000 primitives, which need 375000 chunks, and has 1:"),
     (CODED, {"primitives": 15_000_000, "chunk": 2**16}, r"claims 15000000 primitives, which need 229 chunks, and has 1:"),
     (CODED, {"primitives": 2**20, "chunk": 2**20}, r"chunks of 1048576 primitives, expected up to 65536"),
     (CODED, {"primitives": 2**16, "chunk": 2**16}, r"a chunk that is none")],
)  # fmt: skip
def test_a_small_packed_file_that_claims_many_gaussians(tmp_path, version, changed, said):
    path = tmp_path / "model.spgs"
    claiming(path, version, **changed)
    for read in (read_packed, lambda path: unpack_packed(path, tmp_path / "out")):
        peaks: dict[str, float] = {}
        with peak_within(peaks, "before"):
            pass
        with peak_within(peaks, "after"), pytest.raises(DataError, match=rf"model\.spgs: {said}"):
            read(path)
        assert peaks["after"] - peaks["before"] < 30


@pytest.mark.parametrize("content", [b"", bytes(24), bytes(200)])
def test_chunks_of_nothing_take_no_memory(tmp_path, content):
    path = tmp_path / "model.spgs"
    write_coded(path, random_gaussians(40, degree=3))
    header, _ = records(path)
    told = json.loads(header) | {"primitives": 100 * 2**16, "chunk": 2**16}
    with path.open("wb") as file:
        writer = RecordWriter(file, CODED)
        for part in (json.dumps(told).encode(), *[content] * 100):
            writer.add(part)
    peaks: dict[str, float] = {}
    with peak_within(peaks, "before"):
        pass
    with peak_within(peaks, "after"), pytest.raises(DataError, match="a chunk that is none"):
        read_packed(path)  # 1.5 GB are claimed
    assert peaks["after"] - peaks["before"] < 100


def ply(path: Path, kind: str, count: int) -> None:
    path.write_text(
        f"ply\nformat {kind} 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n1 2 3\n"
    )


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("count", [10**12, 2**62, 10**400, -1])
def test_points_that_are_more_than_there_can_be(tmp_path, kind, count):
    ply(tmp_path / "a.ply", kind, count)
    for read in (read_ply_points, read_ply):
        with pytest.raises(DataError, match=r"a\.ply: not a (PLY|whole \.ply) file"):
            read(tmp_path / "a.ply")


def test_an_array_that_is_larger_than_its_archive(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, depth=np.zeros((9, 9), np.float32))
    whole = path.read_bytes()
    claim = whole.replace(b"(9, 9)", b"(9999999, 999999999)"[:6].ljust(6), 1)
    assert claim == whole or len(claim) == len(whole)
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (99999999, 99999999), }"
    start = whole.index(b"{'descr'")
    end = whole.index(b"\n", start)
    path.write_bytes(whole[:start] + header.ljust(end - start) + whole[end:])
    with pytest.raises(DataError, match=r"a\.npz: no array 'depth' to read"):
        read_arrays(path, "depth")


def test_an_spz_that_unpacks_to_more_than_its_gaussians(tmp_path):
    path = tmp_path / "a.spz"
    write_spz(path, random_gaussians(9), version=3)
    whole = gzip.decompress(path.read_bytes())
    assert len(read_spz(path)) == 9
    path.write_bytes(gzip.compress(whole + bytes(60 * 2**20), compresslevel=1))
    before = peak_memory_mb()
    with pytest.raises(DataError, match=r"a\.spz: unpacks to more than its 9 Gaussians"):
        read_spz(path)
    assert peak_memory_mb() - before < 40
    for size in range(0, len(whole), 37):
        path.write_bytes(gzip.compress(whole)[:size])
        with pytest.raises(DataError, match=r"a\.spz: "):
            read_spz(path)


def spz_4(count: int, degree: int, frame: Callable[[int], bytes]) -> bytes:
    """A file of version 4, whole in its own terms, of the frames that are made for so many raw bytes."""
    raw = [count * each for each in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)) if each]
    frames = [frame(size) for size in raw]
    head = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, count, degree, 12, 0, len(raw), 32)
    table = [struct.pack("<QQ", len(one), size) for one, size in zip(frames, raw, strict=True)]
    return head + b"".join(table) + b"".join(frames)


def zeros(size: int) -> bytes:
    return zstandard.compress(bytes(size))


def growth_of(path: Path, said: str) -> float:
    """Peak in 2^20 bytes that refusing a file takes."""
    peaks: dict[str, float] = {}
    with peak_within(peaks, "before"):
        pass
    with peak_within(peaks, "after"), pytest.raises((DataError, MissingError), match=said):
        read_spz(path)
    return peaks["after"] - peaks["before"]


def test_a_small_spz_that_claims_many_gaussians(tmp_path):
    path = tmp_path / "a.spz"
    path.write_bytes(spz_4(300, 1, zeros))
    assert len(read_spz(path)) == 300
    path.write_bytes(spz_4(1_500_000, 3, zeros))
    assert path.stat().st_size < 8_000
    assert growth_of(path, r"a\.spz: says that its \d+ bytes hold 338 MB") < 20


def test_frames_of_an_spz_that_unpack_to_more_than_their_table_says(tmp_path):
    path = tmp_path / "a.spz"
    path.write_bytes(spz_4(300, 1, lambda size: zeros(size + 300 * 2**20)))
    assert growth_of(path, r"a\.spz: not a whole \.spz file \(stream 0 .* or 31457\d+,") < 20
    silent = zstandard.ZstdCompressor(write_content_size=False)
    path.write_bytes(spz_4(300, 1, lambda size: silent.compress(bytes(size))))
    assert len(read_spz(path)) == 300  # a frame need not say


@pytest.mark.parametrize("version", [3, 4])
def test_the_numbers_of_an_spz_need_room_too(tmp_path, monkeypatch, version):
    path = tmp_path / "a.spz"
    write_spz(path, random_gaussians(40_000, degree=3), version=version)
    unpacked, numbers = 40_000 * 65, 4 * 40_000 * 59
    for free, refused in ((unpacked + numbers, True), (3 * unpacked + 4 * numbers, False)):
        monkeypatch.setattr(memory, "available_mb", lambda free=free: free / memory.SHARE / 2**20)
        if refused:
            with pytest.raises(MissingError, match=r"a\.spz: takes \d+ MB to read"):
                read_spz(path)
        else:
            assert len(read_spz(path)) == 40_000


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [(0, b"P", "begins with"), (4, b"\5", "begins with"), (8, b"\x29", "for each of 41 Gaussians"),
     (12, b"\4", "SH degree 4"), (15, b"\5", "5 streams"), (16, b"\1\0\0\0", "table at byte 1,"),
     (16, b"\xff" * 4, "table at byte"), (32, b"\xff" * 8, "stream 0 of"), (40, b"\0", "stream 0 of"),
     (128, b"\0\0\0\0", "not a whole")],
)  # fmt: skip
def test_an_spz_whose_header_and_table_disagree(tmp_path, place, value, said):
    path = tmp_path / "a.spz"
    whole = spz_4(40, 1, zeros)
    path.write_bytes(whole[:place] + value + whole[place + len(value) :])
    with pytest.raises(DataError, match=said) as caught:
        read_spz(path)
    assert str(caught.value).startswith(str(path))


def test_an_spz_of_version_4_that_was_cut(tmp_path):
    path = tmp_path / "a.spz"
    whole = spz_4(40, 1, zeros)
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        with pytest.raises(DataError, match=r"a\.spz: "):
            read_spz(path)


def test_an_unpacked_spz_that_is_too_short_for_its_gaussians(tmp_path):
    path = tmp_path / "a.spz"
    write_spz(path, random_gaussians(9), version=3)
    whole = gzip.decompress(path.read_bytes())
    for raw in (whole[:-1], whole[:7], b""):
        path.write_bytes(gzip.compress(raw))
        with pytest.raises(
            DataError, match=rf"a\.spz: not a whole \.spz file \({len(raw)} bytes unp"
        ):
            read_spz(path)


@pytest.mark.parametrize("name", ["a.ply", "a.spz", "a.sog", "a.glb", "a.spgs", "folder"])
def test_a_model_that_is_a_pipe_is_not_waited_for(tmp_path, name):
    path = tmp_path / name
    if name == "folder":
        path.mkdir()
        os.mkfifo(path / "model.json")
    else:
        os.mkfifo(path)
    with pytest.raises(DataError, match=f"{name}.* (is a pipe, expected a file|no such file)"):
        load_reconstruction(path)


def test_deep_nesting_in_a_binary_gltf(tmp_path):
    text = b"[" * 100_000
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", 0, b"BIN\0")
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    with pytest.raises(DataError, match=r"a\.glb: not a whole \.glb file"):
        load_reconstruction(tmp_path / "a.glb")
