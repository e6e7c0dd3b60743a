"""`bench export MODEL`: a trained model as a file that other tools open."""

from pathlib import Path
from typing import Annotated

import tyro

from splatbench.cli import output


def export(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    *,
    ply: Path,
    local: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> int:
    """Write a trained model as a .ply with the original 3DGS release's properties.

    Positions return to the scene's original frame: where that is shifted (UTM, say), x, y, z are
    written in float64, which some viewers do not read.

    Args:
        model: Model folder, as `bench fit` writes it.
        ply: File to write.
        local: Keep the scene's local frame, with all properties in float32, for any viewer.
    """
    from splatbench.methods.ply import write_ply
    from splatbench.methods.reconstruction import ExplicitModel, load_reconstruction

    loaded = load_reconstruction(model)
    shift = loaded.shift if isinstance(loaded, ExplicitModel) and not local else None
    write_ply(ply, loaded.gaussians(), shift)
    moved = [] if shift is None else [v for v in shift.tolist() if v]
    frame = f"shifted back by {shift.tolist()}" if shift is not None and moved else "as trained"
    record = {"ply": str(ply), "gaussians": loaded.primitives, "frame": frame}
    output.emit(record, f"{ply}: {loaded.primitives} Gaussians, positions {frame}")
    return 0
