"""Targets: photos, archives, suites, protocols, registries and records."""

import io
import json
import shutil
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from PIL import Image

from fuzz import layouts
from fuzz.layout import BINARY, JSON, TEXT, Layout, Part
from fuzz.layouts import members
from fuzz.mutations import changed_bytes
from fuzz.target import Target
from helpers import case_folders
from helpers.aerial_photos import save_photo
from splatproof.datasets.archives import extract
from splatproof.datasets.catalogue.registry import read_registry
from splatproof.datasets.ingesting.survey import survey_photos
from splatproof.datasets.ingesting.upright import copy_upright
from splatproof.datasets.photos import PEAK, check_photo, photo_size, read_photo
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.result_json import result_to_json
from splatproof.reports.comparing import baselines
from splatproof.suites.records import RECORD_NAME, read_record
from splatproof.suites.suite_files import load_suite

UNPACKED = 2**24
"""Bytes that an archive of the fuzzer may unpack to."""


def _picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (12, 16, 3), dtype=np.uint8)


def _saved(kind: str, mode: str = "RGB", **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(_picture()).convert(mode).save(file, kind, **options)
    return file.getvalue()


def _read_photo(path: Path) -> object:
    photo_size(path)
    check_photo(path)
    return read_photo(path, (0.0, 0.0, 0.0)), read_photo(path)


def _pixels(data: bytes) -> int:
    """Bytes that the pixels of a photo take while it is read: a few bytes of file may be any number."""
    try:
        with Image.open(io.BytesIO(data)) as image:
            return PEAK * image.width * image.height
    except Exception:  # noqa: BLE001 (whatever Pillow says: then there are no pixels)
        return 0


def png(folder: Path) -> Target:
    """PNG of 8 and 16 bits, of a palette, grey and transparent."""
    deep = cv2.imencode(".png", _picture().astype(np.uint16) * 257)[1].tobytes()
    samples = [_saved("PNG"), deep, *(_saved("PNG", mode) for mode in ("P", "L", "RGBA"))]
    return Target(
        path=folder / "a.png", samples=samples, layout=layouts.PNG, read=_read_photo, room=_pixels
    )


def jpeg(folder: Path) -> Target:
    """JPEG, sequential, progressive and grey."""
    samples = [_saved("JPEG"), _saved("JPEG", progressive=True), _saved("JPEG", "L")]
    return Target(
        path=folder / "a.jpg", samples=samples, layout=BINARY, read=_read_photo, room=_pixels
    )


def tiff(folder: Path) -> Target:
    """TIFF, plain and deflated."""
    samples = [_saved("TIFF"), _saved("TIFF", compression="tiff_deflate")]
    return Target(
        path=folder / "a.tif", samples=samples, layout=BINARY, read=_read_photo, room=_pixels
    )


def exif(folder: Path) -> Target:
    """EXIF of a photo that is taken in: the survey, and the copy as it is looked at."""
    for name in ("a.jpg", "b.jpg"):
        save_photo(folder / "photos" / name, _picture(), (1.0, 2.0, 3.0))
    path, copy = folder / "photos/a.jpg", folder / "copy.jpg"

    def read(path: Path) -> object:
        found = survey_photos(path.parent, lambda done, total: None)
        for photo in found.photos:
            copy_upright(photo.path, copy)
        return [photo.gps[:2] for photo in found.photos if photo.gps]

    def split(data: bytes) -> list[Part]:
        at = data.index(b"Exif\0\0") + 6
        end = at - 8 + int.from_bytes(data[at - 8 : at - 6], "big")
        return [(changed_bytes, data[at:end])]

    whole = path.read_bytes()
    at = whole.index(b"Exif\0\0") + 6
    end = at - 8 + int.from_bytes(whole[at - 8 : at - 6], "big")
    rest = whole[: at - 10], whole[end:]

    def join(contents: list[bytes]) -> bytes:
        block = b"Exif\0\0" + contents[0][:65_000]
        return rest[0] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + rest[1]

    return Target(path=path, samples=[whole], layout=Layout(split, join), read=read, named=False)


def _zip(rows: list[tuple[str, str, bytes]]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, kind, content in rows:
            info = zipfile.ZipInfo(name or "x")
            info.external_attr = {"link": 0o120777, "device": 0o060666}.get(kind, 0o100644) << 16
            archive.writestr(info, content)
    return file.getvalue()


def _tar(mode: Literal["w", "w:gz"]) -> Callable[[list[tuple[str, str, bytes]]], bytes]:
    def write(rows: list[tuple[str, str, bytes]]) -> bytes:
        file = io.BytesIO()
        with tarfile.open(fileobj=file, mode=mode) as archive:
            for name, kind, content in rows:
                info = tarfile.TarInfo(name)
                kinds = {
                    "link": tarfile.SYMTYPE,
                    "device": tarfile.CHRTYPE,
                    "folder": tarfile.DIRTYPE,
                }
                info.type = kinds.get(kind, tarfile.REGTYPE)
                info.linkname, info.size = "/etc/passwd", len(content) if kind == "file" else 0
                archive.addfile(info, io.BytesIO(content))
        return file.getvalue()

    return write


def archive(ending: str) -> Callable[[Path], Target]:
    """An archive of two photos in a folder."""
    write = {".zip": _zip, ".tar": _tar("w"), ".tar.gz": _tar("w:gz")}[ending]
    rows = [
        ["town/a.png", "file", "abc" * 40],
        ["town/deep/b.png", "file", "x"],
        ["town/c", "file", ""],
    ]

    def build(folder: Path) -> Target:
        out = folder / "out"

        def read(path: Path) -> object:
            shutil.rmtree(out, ignore_errors=True)
            extract(path, out, limit=UNPACKED)
            assert sorted(entry.name for entry in folder.iterdir()) == sorted([path.name, "out"])
            return None

        return Target(
            path=folder / f"archive{ending}", samples=[json.dumps(rows).encode()], layout=members(write),
            read=read,
        )  # fmt: skip

    return build


SUITE = """
description = "Fuzzed"
optional_scenes = ["./other"]
[[cases]]
scenes = ["./town", "./other", "courtyard"]
methods = ["3dgs", "3dgs@long"]
protocols = ["default"]
seeds = [0, 1]
width = 64
pose_noise = ["none"]
[cases.settings.3dgs]
iterations = 300
sh_degree = 2
[cases.settings."3dgs@long"]
iterations = 3_000
"""
PROTOCOL = """
source = "ours"
images = "photos"
hold = 8
factor = 2.0
background = [0.0, 0.5, 1.0]
metrics = ["psnr", "ssim_3dgs"]
clips = [["a", 0, 10]]
"""
REGISTRY = """
[town]
kind = "real"
licence = "CC0"
source = "us"
about = "a town"
folders = ["a/town", "b"]
files = {"photos/a.jpg" = "00"}
[set]
kind = "made"
licence = "CC0"
source = "us"
about = "worlds"
world = "city"
scenes = ["one", "two"]
"""


def suite(folder: Path) -> Target:
    """Suites."""
    (folder / "town").mkdir()
    return Target(
        path=folder / "mine.toml", samples=[SUITE.encode()], layout=TEXT,
        read=lambda path: [case.label for case in load_suite(path).cases],
    )  # fmt: skip


def protocol(folder: Path) -> Target:
    """Protocols."""
    return Target(
        path=folder / "mine.toml", samples=[PROTOCOL.encode()], layout=TEXT, read=load_protocol
    )


def registry(folder: Path) -> Target:
    """Registries of scenes."""
    return Target(
        path=folder / "registry.toml", samples=[REGISTRY.encode()], layout=TEXT,
        read=read_registry,
    )  # fmt: skip


def record(folder: Path) -> Target:
    """Records of results, which may hold NaN."""
    text = result_to_json(case_folders.result())
    return Target(
        path=folder / RECORD_NAME, samples=[text.encode()], layout=JSON, finite=False,
        read=lambda path: read_record(path.parent),
    )  # fmt: skip


def baseline(folder: Path) -> Target:
    """Files of frozen results, their checksum made right."""
    source = next(baselines.FOLDER.glob("*.json"))
    tree = json.loads(source.read_text())
    tree["cases"] = tree["cases"][:2]

    def seal(path: Path) -> None:
        try:
            tree = json.loads(path.read_bytes())
            body = {name: tree.get(name) for name in (*baselines.SHARED, "cases")}
            path.write_text(json.dumps(tree | {"sha256": baselines.checksum(body)}))
        except (ValueError, RecursionError, AttributeError, TypeError):
            return

    return Target(
        path=folder / "b.json", samples=[json.dumps(tree).encode()], layout=JSON, finite=False,
        read=lambda path: baselines.read(path, "b"), prepare=seal,
    )  # fmt: skip


FILES: dict[str, Callable[[Path], Target]] = {
    "png": png, "jpeg": jpeg, "tiff": tiff, "exif": exif, "zip": archive(".zip"), "tar": archive(".tar"),
    "tar.gz": archive(".tar.gz"), "suite": suite, "protocol": protocol, "registry": registry,
    "record": record, "baseline": baseline,
}  # fmt: skip
