"""Targets: models, their folders and every file of Gaussians."""

import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData

from fuzz import layouts
from fuzz.layout import BINARY, JSON
from fuzz.target import Target
from helpers.tiny_scene import random_gaussians
from splatproof.base.files import sha256
from splatproof.methods.contracts.reconstruction import ARRAYS, DESCRIPTION, Origin, save_model
from splatproof.methods.loading import load_origin, load_reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.camera_files import read_cameras
from splatproof.methods.storage.gltf import read_gltf, write_gltf
from splatproof.methods.storage.packed.coded_chunk import Profile
from splatproof.methods.storage.packed.coded_writer import CodeSettings, write_coded
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.writer import FileSettings, write_packed
from splatproof.methods.storage.ply import read_mode, read_ply, write_ply
from splatproof.methods.storage.sog import read_sog, write_sog
from splatproof.methods.storage.spz import read_spz, write_spz
from splatproof.reference.compression import container, packing
from splatproof.reference.types.gaussians import Gaussians

SHIFT = torch.tensor([5.0, 6.0, 7.0], dtype=torch.float64)


def _written(folder: Path, ending: str, *writers: Callable[[Path], object]) -> list[bytes]:
    """What each writer writes."""
    samples = []
    for write in writers:
        path = folder / f"sample{ending}"
        write(path)
        samples.append(path.read_bytes())
        path.unlink()
    return samples


def gaussians_ply(folder: Path) -> Target:
    """Gaussians as .ply: plain, shifted, antialiased, ascii."""
    small, flat = random_gaussians(5, degree=1), random_gaussians(3, degree=0)
    samples = _written(
        folder,
        ".ply",
        lambda p: write_ply(p, small),
        lambda p: write_ply(p, flat, SHIFT, "antialiased"),
    )
    data, text = PlyData.read(io.BytesIO(samples[1])), io.BytesIO()
    PlyData(list(data), text=True, comments=data.comments).write(text)
    return Target(
        path=folder / "model.ply", samples=[*samples, text.getvalue()], layout=layouts.PLY,
        read=lambda path: (read_ply(path), read_mode(path)),
    )  # fmt: skip


def spz(version: int) -> Callable[[Path], Target]:
    """.spz: version 3 is a gzip stream, which is inflated before it is changed."""

    def build(folder: Path) -> Target:
        small, flat = random_gaussians(6, degree=1), random_gaussians(4, degree=0)
        kind = 3 if version == 3 else 4
        samples = _written(
            folder,
            ".spz",
            lambda p: write_spz(p, small, version=kind),
            lambda p: write_spz(p, flat, version=kind),
        )
        layout = layouts.GZIP if version == 3 else BINARY
        return Target(path=folder / "model.spz", samples=samples, layout=layout, read=read_spz)

    return build


def sog(folder: Path) -> Target:
    """.sog: with a palette of harmonics, and without."""
    samples = _written(
        folder, ".sog", lambda p: write_sog(p, random_gaussians(12, degree=1), palette=4),
        lambda p: write_sog(p, random_gaussians(4, degree=0), "antialiased"),
    )  # fmt: skip
    return Target(path=folder / "model.sog", samples=samples, layout=layouts.SOG, read=read_sog)


def glb(folder: Path) -> Target:
    """.glb."""
    samples = _written(
        folder, ".glb", lambda p: write_gltf(p, random_gaussians(5, degree=1)),
        lambda p: write_gltf(p, random_gaussians(3, degree=0), SHIFT, "antialiased"),
    )  # fmt: skip
    return Target(path=folder / "model.glb", samples=samples, layout=layouts.GLB, read=read_gltf)


def packed(folder: Path) -> Target:
    """Packed models of version 2, of one chunk and of streams kept as they are."""
    model = random_gaussians(20, degree=1)
    plain = FileSettings(sort=False, planes=False, entropy="none", gate=0.0)
    samples = _written(
        folder,
        ".spgs",
        lambda p: write_packed(p, model),
        lambda p: write_packed(p, model, settings=plain),
    )
    return Target(
        path=folder / "model.spgs", samples=samples, layout=layouts.PACKED,
        read=lambda path: read_packed(path, threads=1)[0],
    )  # fmt: skip


def packed_3(profile: Profile) -> Callable[[Path], Target]:
    """Packed models of version 3."""

    def build(folder: Path) -> Target:
        kept = CodeSettings(profile=profile)
        samples = _written(
            folder,
            ".spgs",
            lambda p: write_coded(p, random_gaussians(20, degree=1), settings=kept),
            lambda p: write_coded(p, random_gaussians(3, degree=0), settings=kept),
        )
        layout = layouts.CODED_SMALL if profile == "small" else layouts.CODED_FAST
        return Target(
            path=folder / "model.spgs", samples=samples, layout=layout,
            read=lambda path: read_packed(path, threads=1)[0],
        )  # fmt: skip

    return build


def packed_1(folder: Path) -> Target:
    """Packed models of version 1."""
    stored = packing.pack(random_gaussians(8, degree=1), packing.PackSettings())
    return Target(
        path=folder / "model.spgs", samples=[container.encode(stored)], layout=layouts.CONTAINER,
        read=lambda path: read_packed(path, threads=1)[0],
    )  # fmt: skip


def _folder(folder: Path) -> None:
    model = ExplicitModel(model=random_gaussians(4, degree=1), shift=SHIFT)
    save_model(
        model, folder, Origin(method="3dgs", scene="town", settings={"iterations": 3}, seed=1)
    )


def _read_folder(path: Path) -> Gaussians:
    load_origin(path.parent)
    model = load_reconstruction(path.parent)
    assert isinstance(model, ExplicitModel)
    assert model.shift.isfinite().all()
    return model.model


def description(folder: Path) -> Target:
    """model.json of a folder whose arrays are intact."""
    _folder(folder)
    path = folder / DESCRIPTION
    return Target(
        path=path, samples=[path.read_bytes()], layout=JSON, read=_read_folder, named=False
    )


def tensors(folder: Path) -> Target:
    """model.safetensors of a folder whose model.json has its hash."""
    _folder(folder)
    path, told = folder / ARRAYS, json.loads((folder / DESCRIPTION).read_text())

    def seal(path: Path) -> None:
        whole = told | {"arrays_sha256": sha256(path)}
        (path.parent / DESCRIPTION).write_text(json.dumps(whole))

    return Target(
        path=path, samples=[path.read_bytes()], layout=layouts.SAFETENSORS, read=_read_folder,
        prepare=seal, named=False,
    )  # fmt: skip


def cameras(folder: Path) -> Target:
    """Camera files."""
    K = [[50.0, 0, 16], [0, 50, 12], [0, 0, 1]]
    one = {"name": "a", "width": 32, "height": 24, "K": K, "world_to_camera": np.eye(4).tolist()}
    two = one | {"name": "b", "time": 1.5, "sensor": "left", "appearance": "0.png"}
    return Target(
        path=folder / "flight.json", samples=[json.dumps([one, two]).encode()], layout=JSON,
        read=lambda path: [dataclasses.asdict(view.camera) for view in read_cameras(path).values()],
    )  # fmt: skip


MODELS: dict[str, Callable[[Path], Target]] = {
    "gaussians ply": gaussians_ply, "spz 3": spz(3), "spz 4": spz(4), "sog": sog, "glb": glb, "packed": packed,
    "packed 1": packed_1, "packed 3": packed_3("small"), "packed 3 fast": packed_3("fast"), "model.json": description, "model.safetensors": tensors, "cameras": cameras,
}  # fmt: skip
