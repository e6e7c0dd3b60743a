"""Loads what training left behind, whatever kind of model it is."""

from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.methods.city.model import CITY, load_city
from splatproof.methods.contracts.method import Loader
from splatproof.methods.contracts.reconstruction import (
    DESCRIPTION,
    Origin,
    Reconstruction,
    origin_of,
    read_stored,
    require_kind,
)
from splatproof.methods.gaussian_files import FOREIGN, is_file, read_gaussians
from splatproof.methods.models.explicit import (
    EXPLICIT,
    ExplicitModel,
    load_explicit,
)
from splatproof.methods.models.exposure import EXPOSED, load_exposed
from splatproof.methods.registry import methods
from splatproof.methods.storage.packed.reader import read_packed

DAMAGED = (
    AttributeError, IndexError, KeyError, OverflowError, RecursionError, RuntimeError, TypeError,
    ValueError,
)  # fmt: skip
"""What a loader meets in facts or arrays of another shape than it wrote."""


def loaders() -> dict[str, Loader]:
    """How each kind of model is loaded: the built-in kinds and those of every method."""
    known: dict[str, Loader] = {
        EXPLICIT: load_explicit, EXPOSED: load_exposed, CITY: load_city,
    }  # fmt: skip
    for method in methods().values():
        known |= dict(method.loaders)
    return known


def load_reconstruction(folder: str | Path, *, backend: str = "cpu") -> Reconstruction:
    """The model that `save_model` wrote into a folder, or a packed one.

    Args:
        folder: Folder with model.json and model.safetensors, or a .ply, .spz, .sog, .glb or packed file.
        backend: Name of the rasterizer to draw it with.

    Raises: DataError, in one line, if a file is missing, damaged, foreign or of a newer version;
        MissingError for an .spz without the package that reads it.
    """
    folder = Path(folder)
    if is_file(folder):
        model, told = read_gaussians(folder)
        return ExplicitModel(
            model=model, backend=backend, mode=told.mode, shift=told.shift, units=told.units
        )
    stored, known = read_stored(folder), loaders()
    load = known[require_kind(stored.facts, known, folder)]
    try:
        return load(folder, stored, backend)
    except DAMAGED as error:  # facts or arrays that the loader did not expect, under right hashes
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise DataError(f"{folder / DESCRIPTION}: damaged ({said}); copy it again") from error


def load_origin(folder: str | Path) -> Origin:
    """Where a model comes from: its model.json, or what a packed file says; others say nothing.

    Args:
        folder: As for `load_reconstruction`.

    Raises: DataError if it cannot be read.
    """
    folder = Path(folder)
    if folder.suffix.lower() in FOREIGN:
        return Origin()
    if folder.is_file():
        return read_packed(folder)[1].origin
    return origin_of(folder)
