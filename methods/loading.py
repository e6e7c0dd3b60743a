"""Loads what training left behind, whatever kind of model it is."""

from pathlib import Path

from splatproof.methods.city.model import CITY, load_city
from splatproof.methods.contracts.method import Loader
from splatproof.methods.contracts.reconstruction import (
    Origin,
    Reconstruction,
    origin_of,
    read_stored,
    require_kind,
)
from splatproof.methods.models.explicit import (
    EXPLICIT,
    ExplicitModel,
    check_gaussians,
    load_explicit,
)
from splatproof.methods.models.exposure import EXPOSED, load_exposed
from splatproof.methods.registry import methods
from splatproof.methods.storage.packed.reader import read_packed


def loaders() -> dict[str, Loader]:
    """How each kind of model is loaded: the built-in kinds and those of every method."""
    known: dict[str, Loader] = {
        EXPLICIT: load_explicit, EXPOSED: load_exposed, CITY: load_city,
    }  # fmt: skip
    for method in methods().values():
        known |= dict(method.loaders)
    return known


def load_reconstruction(folder: Path, *, backend: str = "cpu") -> Reconstruction:
    """The model that `save_model` wrote into a folder, or a packed one.

    Args:
        folder: Folder with model.json and model.safetensors, or a file of methods.storage.packed.
        backend: Name of the rasterizer to draw it with.

    Raises: DataError, in one line, if a file is missing, damaged, foreign or of a newer version.
    """
    if folder.is_file():
        model, packed = read_packed(folder)
        check_gaussians(model, folder)
        return ExplicitModel(
            model=model, backend=backend, mode=packed.mode, shift=packed.shift, units=packed.units
        )
    stored, known = read_stored(folder), loaders()
    return known[require_kind(stored.facts, known, folder)](folder, stored, backend)


def load_origin(folder: Path) -> Origin:
    """Where a model comes from: its model.json, or what a packed file says.

    Args:
        folder: As for `load_reconstruction`.

    Raises: DataError if it cannot be read.
    """
    if folder.is_file():
        return read_packed(folder)[1].origin
    return origin_of(folder)
