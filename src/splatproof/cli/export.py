"""`bench export MODEL`: a trained model as a file that other tools open."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatproof.cli import output
from splatproof.cli.models import model_path

if TYPE_CHECKING:
    from splatproof.methods.contracts.reconstruction import Origin, Reconstruction
    from splatproof.reference.types.gaussians import Gaussians


GATE = 0.02
"""Mean size of the view-dependent colour below which a packed Gaussian loses it."""


def export(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    *,
    ply: Path | None = None,
    packed: Path | None = None,
    gate: float | None = None,
    local: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> int:
    """Write a trained model as a .ply with the original 3DGS release's properties, or packed small.

    In a .ply positions return to the scene's original frame: where that is shifted (UTM, say), x, y
    and z are written in float64, which some viewers do not read. A packed file keeps the local frame
    and says the shift; `bench render` and `bench export` take it wherever they take a model folder.

    With --json each written file is a line: ply or packed (its path), gaussians, and frame of a
    .ply; bytes, bytes_by_part and open_share of a packed file.

    Args:
        model: The folder that `bench fit` calls OUT, the model folder in it, or a packed file.
        ply: Path of the .ply file to write.
        packed: Path of the packed file to write.
        gate: With --packed: a Gaussian whose view-dependent colour is smaller than this on average,
            in units of colour (0 to 1), loses it; 0 keeps all. None: 0.02.
        local: With --ply: keep the scene's local frame, with all properties in float32, so that any
            viewer reads it.
    """
    from splatproof.base.errors import UsageError
    from splatproof.methods.loading import load_origin, load_reconstruction
    from splatproof.methods.storage.ply import write_ply

    if ply is None and packed is None:
        raise UsageError("nothing to write: expected --ply FILE or --packed FILE")
    if packed is None and gate is not None:
        raise UsageError("--gate is for --packed FILE; add it or leave --gate out")
    if ply is None and local:
        raise UsageError("--local is for --ply FILE; add it or leave --local out")
    loaded = load_reconstruction(model_path(model))
    if packed is not None:
        _pack(loaded, load_origin(model_path(model)), packed, GATE if gate is None else gate)
    if ply is None:
        return 0
    shift = None if local else getattr(loaded, "shift", None)
    write_ply(ply, _baked(loaded), shift)
    moved = [] if shift is None else [v for v in shift.tolist() if v]
    frame = f"shifted back by {shift.tolist()}" if shift is not None and moved else "as trained"
    record = {"ply": str(ply), "gaussians": loaded.primitives, "frame": frame}
    output.emit(record, f"{ply}: {loaded.primitives} Gaussians, positions {frame}")
    return 0


def _baked(model: "Reconstruction") -> "Gaussians":
    """The model as explicit Gaussians."""
    from splatproof.base.errors import UsageError
    from splatproof.methods.contracts.reconstruction import Bakes

    if not isinstance(model, Bakes):
        raise UsageError(f"a model of kind {model.kind!r} cannot be turned into explicit Gaussians")
    return model.bake()


def _pack(model: "Reconstruction", origin: "Origin", path: Path, gate: float) -> None:
    """Write a packed file and say how small it is."""
    from splatproof.methods.storage.packed.writer import FileSettings, PackedFacts, write_packed

    known = {n: getattr(model, n) for n in ("mode", "shift", "units") if hasattr(model, n)}
    facts = PackedFacts(**known, origin=origin)
    report = write_packed(path, _baked(model), settings=FileSettings(gate=gate), facts=facts)
    each = report.bytes / max(report.primitives, 1)
    record = {"packed": str(path), "gaussians": report.primitives, "bytes": report.bytes,
              "bytes_by_part": dict(report.bytes_by_part), "open_share": report.open_share}  # fmt: skip
    output.emit(record, f"{path}: {report.primitives} Gaussians, {each:.1f} bytes each")
