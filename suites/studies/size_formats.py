"""Ways to store a model that the size study compares, each a point of a curve."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from splatproof.methods.contracts.reconstruction import ARRAYS, Origin, save_model
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.packed.coded_writer import QUALITIES, CodeSettings, write_coded
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.writer import FileSettings, write_packed
from splatproof.methods.storage.ply import read_ply, write_ply
from splatproof.methods.storage.sog import read_sog, write_sog
from splatproof.methods.storage.spz import (
    ALL_BITS,
    USUAL_BITS,
    Version,
    read_spz,
    write_spz,
)
from splatproof.reference.compression import container
from splatproof.reference.compression import packing as reference
from splatproof.reference.compression.quantisers import Steps
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.studies.size_images import read_images, write_images

GATES = (0.0, 0.02, 0.08)
"""gamma of StitchGS and around it."""
HARMONICS = (0.02, 0.03, 0.06, 0.1)
"""Steps of harmonics around the default."""
FAST = (0.1,)
BITS = (7, 5)
"""Bits of a coefficient of harmonics in images."""
PALETTES = {"sog 1024": 1024, "sog 4096": 4096, "sog": None}
"""Entries of the palette of harmonics; None: as many as the format's own encoder takes."""
SPZ: tuple[Version, ...] = (3, 4)


@dataclass(frozen=True, kw_only=True)
class Format:
    """One way to store a model."""

    name: str
    curve: str
    """Name of the ways that differ from this one only in how much they keep."""
    write: Callable[[Path, Gaussians], Mapping[str, int]]
    """Writes a file and says its bytes by part, if it can."""
    read: Callable[[Path], Gaussians]


def formats() -> list[Format]:
    """All ways, the plain ones first."""
    plain = FileSettings(gate=0.0, sort=False, planes=False, entropy="none")
    coded = FileSettings(gate=0.0, sort=False, planes=False)
    standard = CodeSettings()
    return [
        Format(name="ply", curve="ply", write=_write_ply, read=lambda path: read_ply(path)[0]),
        Format(name="safetensors", curve="safetensors", write=_write_folder, read=_read_folder),
        _packed("codes alone", plain),
        _packed("+ zstd", coded),
        Format(name="reference container", curve="version 1", write=_write_reference,
               read=lambda path: read_packed(path)[0]),
        *(_packed(f"gate {gate}", FileSettings(gate=gate), "version 2") for gate in GATES),
        *(coded_format(name, kept) for name, kept in QUALITIES.items()),
        *(coded_format(f"small {step}", replace(standard, harmonics=step)) for step in HARMONICS),
        coded_format("fast", replace(standard, profile="fast")),
        *(coded_format(f"fast {step}", replace(standard, profile="fast", harmonics=step)) for step in FAST),
        *(Format(name=f"spz {version}{word}", curve=f"spz {version}", write=partial(_write_spz, version, bits),
                 read=read_spz)
          for version in SPZ for word, bits in (("", USUAL_BITS), (", 8 bits", ALL_BITS))),
        *(Format(name=name, curve="sog", write=partial(_write_sog, entries), read=lambda path: read_sog(path)[0])
          for name, entries in PALETTES.items()),
        *(Format(name=f"png {bits}", curve="png grid", write=partial(_write_images, bits), read=read_images)
          for bits in BITS),
    ]  # fmt: skip


def coded_format(
    name: str,
    settings: CodeSettings,
    instead: Gaussians | None = None,
    steps: Steps | None = None,
    curve: str = "",
) -> Format:
    """Our small file.

    Args:
        name: Name of the way.
        settings: How finely it stores.
        instead: Model that is written in place of the trained one, made of it; None: that one.
        steps: The file's steps; None: those that the settings give the model.
        curve: What was done to the model; empty: nothing.
    """

    def write(path: Path, model: Gaussians) -> Mapping[str, int]:
        whole = model if instead is None else instead
        return write_coded(path, whole, settings=settings, steps=steps).bytes_by_part

    curve = f"ours, {settings.profile}" + (f", {curve}" if curve else "")
    return Format(name=name, curve=curve, write=write, read=lambda path: read_packed(path)[0])


def _packed(name: str, settings: FileSettings, curve: str = "") -> Format:
    """A packed file of version 2."""

    def write(path: Path, model: Gaussians) -> Mapping[str, int]:
        return write_packed(path, model, settings=settings).bytes_by_part

    return Format(
        name=name, curve=curve or name, write=write, read=lambda path: read_packed(path)[0]
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


def _write_spz(
    version: Version, bits: tuple[int, int], path: Path, model: Gaussians
) -> Mapping[str, int]:
    write_spz(path, model, version=version, harmonics=bits)
    return {}


def _write_sog(entries: int | None, path: Path, model: Gaussians) -> Mapping[str, int]:
    write_sog(path, model, palette=entries)
    return {}


def _write_images(bits: int, path: Path, model: Gaussians) -> Mapping[str, int]:
    write_images(path, model, bits=bits)
    return {}
