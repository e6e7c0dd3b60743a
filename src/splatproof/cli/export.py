"""`bench export MODEL`: a trained model as a file that other tools open."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from splatproof.api.paths import model_path
from splatproof.cli import output
from splatproof.cli.baking import UNSEEN, Seen, baked, view_of
from splatproof.cli.smaller import smaller

if TYPE_CHECKING:
    from torch import Tensor

    from splatproof.methods.contracts.reconstruction import Reconstruction
    from splatproof.methods.storage.packed.coded_writer import CodeSettings
    from splatproof.methods.storage.packed.writer import PackedReport
    from splatproof.reference.compression.quantisers import Steps
    from splatproof.reference.rasterizer.rasterize import Mode
    from splatproof.reference.types.gaussians import Gaussians
    from splatproof.reference.types.scene import View


MANY = 50_000
"""Gaussians from which on a .sog's palette takes a core more than some ten seconds."""


def export(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    *,
    ply: Path | None = None,
    spz: Path | None = None,
    sog: Path | None = None,
    gltf: Path | None = None,
    packed: Path | None = None,
    quality: Literal["fine", "standard", "coarse"] | None = None,
    profile: Literal["small", "fast"] | None = None,
    gate: float | None = None,
    thin: float | None = None,
    tune: int | None = None,
    local: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    seen: Annotated[Seen, tyro.conf.arg(name="")] = UNSEEN,
) -> int:
    """Write a trained model as a file that other tools open: .ply, .spz, .sog, .glb, or packed small.

    In a .ply, with the original 3DGS release's properties, positions return to the scene's original
    frame: where that is shifted (UTM, say), x, y and z are written in float64, which some viewers do
    not read. The other kinds keep the local frame; a packed file and a .glb say the shift. `bench
    render`, `bench score` and `bench export` take every kind wherever they take a model folder.

    A .ply and a .glb hold every number as float32. An .spz has 24 bits a coordinate, 8 bits for
    opacity, scale and colour, and 8 or fewer for what depends on the view: small, and not the same. A
    .sog has 16 bits a coordinate, finest near the origin, and one entry of a palette for what depends on
    the view: about as large as an .spz. A packed file is the smallest: every number in steps that the
    image hardly sees, entropy-coded. `bench study size` measures what each costs. Fewer Gaussians
    (--thin) and training through the file's own steps (--tune) make it smaller still.

    A model that decodes its Gaussians for each view, or that moves, is written as it looks from one
    view at one time: --view names the view, --time may change its time, and --cameras, --scene and
    --protocol say where to find it. From other views the file is not what the model shows, and from none
    does it hold what the model adds to a finished image, its sky and exposures: a line on stderr names
    them. Models of plain Gaussians look the same from everywhere and refuse these options.

    With --json each written file is a line: ply, spz, sog, gltf or packed (its path), gaussians, bytes,
    view and time (null where the model is the same from everywhere), and frame of a .ply;
    bytes_by_part and open_share of a packed file.

    Args:
        model: The folder that `bench fit` calls OUT, the model folder in it, or a .ply, .spz, .sog, .glb or
            packed file.
        ply: Path of the .ply file to write.
        spz: Path of the .spz file to write, the small format of web viewers.
        sog: Path of the .sog file to write, version 2: PlayCanvas' format of web viewers, with the palette
            of harmonics as large as its own encoder's.
        gltf: Path of the .glb file to write: binary glTF with the extension KHR_gaussian_splatting.
        packed: Path of the packed file to write.
        quality: With --packed: how fine its steps are. With --spz: coarse keeps 5 and 4 bits of what
            depends on the view, as the format's own encoder does, in place of 8. None: standard.
        profile: With --packed: how its codes become bytes. small: the smallest file; fast: up to a
            quarter larger, and read several times as fast. None: small.
        gate: With --packed: write version 2 of the file instead, which older versions of splatproof
            read: half precision, 8-bit harmonics, and a Gaussian whose view-dependent colour is
            smaller than this on average, in units of colour (0 to 1), loses it; 0 keeps all.
        thin: Share of the Gaussians, 0 to 0.9, that goes first: pairs of near, alike ones become one, by
            how much of the training photos they are. Needs the scene that the model was trained on.
        tune: With --packed: train the model for so many steps through the very steps of the file (some
            hundreds give back more than they cost), on the scene that it was trained on. The same
            command continues a tuning that was interrupted.
        local: With --ply: keep the scene's local frame, with all properties in float32, so that any
            viewer reads it.
        seen: The one view that the model is written at.
    """
    from splatproof.base.errors import UsageError
    from splatproof.base.files import check_target, remove_stale
    from splatproof.base.numbers import in_range
    from splatproof.methods.loading import load_origin, load_reconstruction
    from splatproof.methods.models.decoded import DecodedModel
    from splatproof.methods.storage.gltf import write_gltf
    from splatproof.methods.storage.packed.coded_writer import (
        QUALITIES,
        chosen_steps,
        write_coded,
    )
    from splatproof.methods.storage.packed.rows import MemoryRows
    from splatproof.methods.storage.packed.writer import FileSettings, PackedFacts, write_packed
    from splatproof.methods.storage.sog import write_sog
    from splatproof.methods.storage.spz import ALL_BITS, USUAL_BITS, clipped, write_spz

    if all(path is None for path in (ply, spz, sog, gltf, packed)):
        raise UsageError(
            "nothing to write: expected --ply, --spz, --sog, --gltf or --packed with a FILE"
        )
    for option, path, suffix in (
        ("ply", ply, ".ply"),
        ("spz", spz, ".spz"),
        ("sog", sog, ".sog"),
        ("gltf", gltf, ".glb"),
    ):
        if path is not None and path.suffix.lower() != suffix:
            raise UsageError(f"--{option} {path}: expected a name that ends in {suffix}")
    for path in (ply, spz, sog, gltf, packed):
        if path is not None:
            check_target(path)
            remove_stale(path)
    if packed is None and gate is not None:
        raise UsageError("--gate is for --packed FILE; add it or leave --gate out")
    if packed is None and spz is None and quality is not None:
        raise UsageError(
            "--quality is for --packed FILE or --spz FILE; add one or leave --quality out"
        )
    for name, asked in (("profile", profile), ("tune", tune)):
        if asked is not None and packed is None:
            raise UsageError(f"--{name} is for --packed FILE; add it or leave --{name} out")
    for name, asked in (("quality", quality), ("profile", profile), ("tune", tune)):
        if asked is not None and gate is not None:
            raise UsageError(
                f"--gate writes version 2 of the file, which has no --{name}; leave one out"
            )
    if gate is not None:
        in_range(gate, "--gate")
    if ply is None and local:
        raise UsageError("--local is for --ply FILE; add it or leave --local out")
    kept = replace(QUALITIES[quality or "standard"], profile=profile or "small")
    loaded, steps = load_reconstruction(model_path(model)), None
    view = view_of(model, loaded, seen)
    if thin is not None or tune is not None:
        loaded, steps = smaller(model, thin, tune, packed, kept)
    gaussians = baked(loaded, view)
    if isinstance(loaded, DecodedModel) and loaded.unbaked:
        output.log(f"{model}: what is written lacks {' and '.join(loaded.unbaked)}")
    if packed is not None:
        origin = load_origin(model_path(model))
        told = PackedFacts(**_known(loaded), origin=origin)
        if gate is None:
            steps = steps or chosen_steps(MemoryRows(gaussians), kept)
            report = write_coded(packed, gaussians, settings=kept, steps=steps, facts=told)
            _tell_cells(packed, gaussians, kept, steps)
        else:
            report = write_packed(packed, gaussians, settings=FileSettings(gate=gate), facts=told)
        _tell_packed(packed, report, view)
    facts = PackedFacts(**_known(loaded))
    if facts.mode == "antialiased" and (ply or spz or gltf):
        output.log(
            "the model was trained antialiased, which the file says; viewers that do not ask draw it as the original "
            "release does, thinner or thicker far away"
        )
    if ply is not None:
        _ply(gaussians, view, ply, None if local else facts.shift, facts.mode)
    if spz is not None:
        bits = USUAL_BITS if quality == "coarse" else ALL_BITS
        write_spz(spz, gaussians, harmonics=bits, mode=facts.mode)
        _tell("spz", spz, gaussians, view)
        _tell_steps(spz, gaussians, quality or "standard")
        if lost := clipped(gaussians):
            counts = ", ".join(f"{name} of {count}" for name, count in lost.items())
            output.log(
                f"{spz}: .spz has no room for all numbers of {len(gaussians)} Gaussians, and what is beyond its "
                f"ranges was clipped: {counts}; a .ply or a packed file keeps them"
            )
    if sog is not None:
        if gaussians.degree and len(gaussians) > MANY:
            output.log(f"{sog}: finding a palette for the harmonics of {len(gaussians)} Gaussians; it takes a core "
                       "about a minute for 120,000")  # fmt: skip
        write_sog(sog, gaussians, facts.mode)
        _tell("sog", sog, gaussians, view)
        _tell_opacities(sog, gaussians)
    if gltf is not None:
        write_gltf(gltf, gaussians, facts.shift, facts.mode)
        _tell("gltf", gltf, gaussians, view)
    return 0


def _known(model: "Reconstruction") -> dict[str, Any]:
    """What a model says of itself beside its Gaussians."""
    return {n: getattr(model, n) for n in ("mode", "shift", "units") if hasattr(model, n)}


def _tell(kind: str, path: Path, gaussians: "Gaussians", view: "View | None") -> None:
    """Say what was written in the local frame, and how large it is."""
    seen, words = _looks(view)
    size = path.stat().st_size
    record = {kind: str(path), "gaussians": len(gaussians), "bytes": size} | seen
    output.emit(record, f"{path}: {len(gaussians)} Gaussians{words}, {size / 2**20:.1f} MB")


def _looks(view: "View | None") -> tuple[dict[str, object], str]:
    """Where a written model is looked at from: what --json says of it, and words."""
    if view is None:
        return {"view": None, "time": None}, ""
    when = "" if view.time is None else f" at {view.time:g} s"
    return {"view": view.name, "time": view.time}, f" as seen from {view.name}{when}"


def _ply(
    gaussians: "Gaussians", view: "View | None", path: Path, shift: "Tensor | None", mode: "Mode"
) -> None:
    """Write a .ply file and say in which frame it is."""
    from splatproof.methods.storage.ply import write_ply

    write_ply(path, gaussians, shift, mode)
    moved = [] if shift is None else [v for v in shift.tolist() if v]
    frame = f"shifted back by {shift.tolist()}" if shift is not None and moved else "as trained"
    seen, words = _looks(view)
    size = path.stat().st_size
    record = {"ply": str(path), "gaussians": len(gaussians), "bytes": size, "frame": frame} | seen
    output.emit(record, f"{path}: {len(gaussians)} Gaussians{words}, positions {frame}")


def _tell_packed(path: Path, report: "PackedReport", view: "View | None") -> None:
    """Say how small a packed file is."""
    each = report.bytes / max(report.primitives, 1)
    seen, words = _looks(view)
    record = {"packed": str(path), "gaussians": report.primitives, "bytes": report.bytes,
              "bytes_by_part": dict(report.bytes_by_part), "open_share": report.open_share}  # fmt: skip
    output.emit(
        record | seen, f"{path}: {report.primitives} Gaussians{words}, {each:.1f} bytes each"
    )


def _tell_steps(path: Path, gaussians: "Gaussians", quality: str) -> None:
    """Say where far Gaussians make the positions of an .spz coarser than a packed file of that quality has them."""
    from splatproof.methods.storage.packed.cell_size import widened
    from splatproof.methods.storage.packed.coded_writer import QUALITIES
    from splatproof.methods.storage.spz import fractional_bits

    step = 2.0 ** -fractional_bits(gaussians)
    found = widened(gaussians, QUALITIES[quality].position, step)
    if found is not None:
        output.log(
            f"{path}: positions are stored in steps of {step:.3g}, {found.times:.3g} times as coarse as a packed file "
            f"asks for, because the farthest Gaussian lies {found.farthest:.6g} from the origin along an axis; remove what "
            "lies far out, or shift a model that lies out there as a whole, and export again"
        )


def _tell_opacities(path: Path, gaussians: "Gaussians") -> None:
    """Say how many opacities a .sog stores as 0, where nothing is drawn, and as 1."""
    from splatproof.methods.storage.sog import at_the_ends

    if lost := at_the_ends(gaussians):
        counts = " and ".join(f"{count} as {end}" for end, count in lost.items())
        output.log(
            f"{path}: of {len(gaussians)} opacities a .sog stores {counts}, its nearest of 256; "
            "a .ply or a packed file keeps them"
        )


def _tell_cells(path: Path, gaussians: "Gaussians", kept: "CodeSettings", steps: "Steps") -> None:
    """Say where a few far Gaussians make the positions of all coarser than asked."""
    from splatproof.methods.storage.packed.cell_size import widened

    found = widened(gaussians, kept.position, steps.position)
    if found is not None:
        output.log(
            f"{path}: positions are stored in steps of {steps.position:.3g}, {found.times:.3g} times as "
            f"coarse as asked, because {found.beyond} of {len(gaussians)} Gaussians lie more than "
            f"{found.reach:.4g} from the origin along an axis, the farthest {found.farthest:.6g}; remove "
            "them, or shift a model that lies out there as a whole, and export again"
        )
