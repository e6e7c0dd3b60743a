"""Files of explicit Gaussians, of this project or another tool, by their suffix."""

from dataclasses import replace
from pathlib import Path

from splatproof.methods.models.explicit import check_gaussians
from splatproof.methods.storage.gltf import read_gltf
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.writer import PackedFacts
from splatproof.methods.storage.ply import read_mode, read_ply
from splatproof.methods.storage.sog import read_sog
from splatproof.methods.storage.spz import read_mode as read_spz_mode
from splatproof.methods.storage.spz import read_spz
from splatproof.reference.types.gaussians import Gaussians

FOREIGN = (".ply", ".spz", ".sog", ".glb")
"""Suffixes of files that do not say where their model comes from."""


def is_file(path: Path) -> bool:
    """Whether a path means a file of Gaussians and not a model folder, be it there or not.

    Args:
        path: What the user named.
    """
    return path.is_file() or path.suffix.lower() in FOREIGN


def read_gaussians(path: str | Path) -> tuple[Gaussians, PackedFacts]:
    """The Gaussians of a .ply, .spz, .sog, .glb or packed file and what it says of them.

    Args:
        path: A file; one with none of the suffixes of FOREIGN is a packed file.
    Returns: The Gaussians in float32, checked, and mode, shift, units and origin as far as the file
        says them; a file of FOREIGN has method "import" for an origin.
    Raises: DataError, in one line, for a file that is missing, damaged or another kind of file;
        MissingError for an .spz without the package that reads it.
    """
    path = Path(path)
    facts = PackedFacts()
    match path.suffix.lower():
        case ".ply":
            model, shift = read_ply(path)
            return model, replace(facts, shift=shift, mode=read_mode(path))
        case ".glb":
            model, shift, mode = read_gltf(path)
            return model, replace(facts, shift=shift, mode=mode)
        case ".spz":
            return read_spz(path), replace(facts, mode=read_spz_mode(path))
        case ".sog":
            model, mode = read_sog(path)
            return model, replace(facts, mode=mode)
        case _:
            model, facts = read_packed(path)
            check_gaussians(model, path)
            return model, facts
