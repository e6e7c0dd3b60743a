"""`bench study size`: bytes of a trained model against what they cost in image quality.

Every row is one way to store the same model. PSNR is that of the held-out views, rendered from what
comes back from the file, less that of the model itself; bytes are given by part, so that it shows
what the gate, the codes, the order and the entropy coding each add.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from splatproof.base.errors import MissingError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.contracts.reconstruction import ARRAYS, Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import get_method
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.writer import PARTS, FileSettings, write_packed
from splatproof.methods.storage.ply import read_ply, write_ply
from splatproof.methods.storage.spz import read_spz, write_spz
from splatproof.metrics.pixel import psnr
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.scoring import scene_metrics, score_image
from splatproof.reference.compression import container
from splatproof.reference.compression import packing as reference
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

SCENES = ("brighton_beach", "courtyard")
"""The first that this machine has."""
STEPS, QUICK_STEPS = 2000, 100
GATES = (0.01, 0.02, 0.03, 0.04, 0.08)
"""gamma of StitchGS and around it."""


@dataclass(frozen=True, kw_only=True)
class Format:
    """One way to store a model."""

    name: str
    gate: float | None
    """Energy below which a Gaussian's harmonics are dropped; None: the format keeps all."""
    write: Callable[[Path, Gaussians], Mapping[str, int]]
    """Writes a file and says its bytes by part, if it can."""
    read: Callable[[Path], Gaussians]


def formats() -> list[Format]:
    """All ways, the plain ones first."""
    plain = FileSettings(gate=0.0, sort=False, planes=False, entropy="none")
    coded = FileSettings(gate=0.0, sort=False, planes=False)
    planes = FileSettings(gate=0.0, sort=False)
    gated = FileSettings(sort=False, planes=False, entropy="none")
    return [
        Format(name="ply", gate=None, write=_write_ply, read=lambda path: read_ply(path)[0]),
        Format(name="safetensors", gate=None, write=_write_folder, read=_read_folder),
        _packed("codes alone", plain),
        _packed("+ zstd", coded),
        _packed("+ byte planes", planes),
        _packed("+ order", FileSettings(gate=0.0)),
        _packed("gate, codes alone", gated),
        _packed("gate, no order", FileSettings(sort=False)),
        Format(name="reference container", gate=FileSettings().gate, write=_write_reference,
               read=lambda path: read_packed(path)[0]),
        *(_packed(f"gate {gate}", FileSettings(gate=gate)) for gate in GATES),
        Format(name="spz 3", gate=None, write=partial(_write_spz, 3), read=read_spz),
        Format(name="spz 4", gate=None, write=partial(_write_spz, 4), read=read_spz),
    ]  # fmt: skip


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """One row a format, of a model trained for it on the first scene there is."""
    protocol = load_protocol("quick" if quick else "brighton_250")
    scene = _scene(protocol, quick)
    method = get_method("3dgs")
    steps = QUICK_STEPS if quick else STEPS
    fitted = method.fit(scene, method.settings(iterations=steps), Run(seed=0))
    assert isinstance(fitted, ExplicitModel)
    base = quality(scene, fitted, fitted.model, protocol)
    with tempfile.TemporaryDirectory() as folder:
        for kind in formats():
            yield {"scene": scene.name, "steps": steps, "psnr": base["psnr"]} | row(
                kind, scene, fitted, base["psnr"], protocol, Path(folder) / "model"
            )


def row(
    kind: Format, scene: Scene, fitted: ExplicitModel, base: float, protocol: Protocol, path: Path
) -> dict[str, Any]:
    """Size, times and loss of one format. Times are the second of two runs: the first warms up.

    Args:
        kind: Format that the model is stored in.
        scene: Scene whose held-out views are rendered.
        fitted: Model as it was trained.
        base: PSNR in dB of the trained model against the photos; the loss is counted from it.
        protocol: Rules that the scene was opened under.
        path: File to write the model to.
    """
    count = fitted.primitives
    try:
        _there_and_back(kind, fitted.model, path)
        parts, back, written, read = _there_and_back(kind, fitted.model, path)
    except MissingError as error:
        return {"format": kind.name, "primitives": count, "note": str(error)}
    size = path.stat().st_size
    found = quality(scene, fitted, back, protocol)
    return {
        "format": kind.name, "gate": kind.gate, "primitives": count, "bytes": size,
        "bytes_each": size / count, "psnr_change": found["psnr"] - base,
        "psnr_to_model": found["to_model"], "write_s": written, "read_s": read,
        "write_millions_s": count / written / 1e6, "read_millions_s": count / read / 1e6,
        **{name: parts[name] / count for name in PARTS if name in parts},
    }  # fmt: skip


def _there_and_back(
    kind: Format, model: Gaussians, path: Path
) -> tuple[Mapping[str, int], Gaussians, float, float]:
    """Bytes by part, what comes back, and the seconds of each way."""
    start = time.perf_counter()
    parts = kind.write(path, model)
    written = time.perf_counter() - start
    start = time.perf_counter()
    back = kind.read(path)
    return parts, back, written, time.perf_counter() - start


def quality(
    scene: Scene, fitted: ExplicitModel, model: Gaussians, protocol: Protocol
) -> dict[str, float]:
    """Mean PSNR over the held-out views, to the photos and to the renders of the trained model.

    Args:
        scene: Scene whose held-out views are rendered.
        fitted: Model as it was trained.
        model: Gaussians as they came back from storage.
        protocol: Rules that the scene was opened under; its background is used.
    """
    stored = ExplicitModel(model=model, mode=fitted.mode)
    background = torch.tensor(protocol.background)
    scores, same = [], []
    for view in scene.test_views:
        image = stored.render(view, background).colour
        whole = fitted.render(view, background).colour
        scores.append(score_image(view.name, image, view.load(), protocol))
        same.append(float(psnr(image.clamp(0, 1), whole.clamp(0, 1))))
    return {"psnr": scene_metrics(scores)["psnr"], "to_model": sum(same) / len(same)}


def _scene(protocol: Protocol, quick: bool) -> Scene:
    """The first scene there is; the quick form takes the one that every machine has."""
    for name in SCENES[quick:-1]:
        try:
            return open_scene(name, protocol)
        except MissingError:
            continue
    return open_scene(SCENES[-1], protocol)


def _packed(name: str, settings: FileSettings) -> Format:
    """A packed file."""

    def write(path: Path, model: Gaussians) -> Mapping[str, int]:
        return write_packed(path, model, settings=settings).bytes_by_part

    return Format(
        name=name, gate=settings.gate, write=write, read=lambda path: read_packed(path)[0]
    )


def _write_ply(path: Path, model: Gaussians) -> Mapping[str, int]:
    write_ply(path, model)
    return {}


def _write_folder(path: Path, model: Gaussians) -> Mapping[str, int]:
    path.unlink(missing_ok=True)
    save_model(ExplicitModel(model=model), path.with_name("folder"), Origin(method="3dgs"))
    (path.with_name("folder") / ARRAYS).replace(path)
    return {}


def _read_folder(path: Path) -> Gaussians:
    folder = path.with_name("folder")
    (folder / ARRAYS).unlink(missing_ok=True)
    (folder / ARRAYS).hardlink_to(path)
    model = load_reconstruction(folder)
    assert isinstance(model, ExplicitModel)
    return model.model


def _write_reference(path: Path, model: Gaussians) -> Mapping[str, int]:
    path.write_bytes(container.encode(reference.pack(model, reference.PackSettings())))
    return {}


def _write_spz(version: Any, path: Path, model: Gaussians) -> Mapping[str, int]:
    write_spz(path, model, version=version)
    return {}
