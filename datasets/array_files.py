"""Reads arrays of .npz files beside the photos of a scene folder of ours."""

import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.files import size_of
from splatproof.base.memory import check_room


def read_arrays(path: Path, *names: str) -> list[np.ndarray]:
    """Read some arrays of an .npz; the others are not decoded.

    Args:
        path: The file.
        names: Names of the arrays, in the order in which they are wanted.
    Raises: DataError naming the file, and the array that cannot be read.
    """
    found, name = [], names[0]
    check_room(path, _unpacked(path, names))
    try:
        # opened here: numpy leaves its own handle open when the file is damaged
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            for name in names:
                found.append(arrays[name])
    except (
        OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, MemoryError, RecursionError, SyntaxError, TypeError,
        tokenize.TokenError,  # numpy reads the header of an array as Python
        # zipfile's words where a password is wanted, and, as a kind of it, for a compression that it does not know
        RuntimeError,
    ) as error:  # fmt: skip
        said = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise DataError(
            f"{path}: no array {name!r} to read ({said}); make the scene again"
        ) from None
    return found


def _unpacked(path: Path, names: Sequence[str]) -> int:
    """Bytes that the arrays take, as the archive says; 0 where it cannot be read as one."""
    size_of(path)
    try:
        with zipfile.ZipFile(path) as packed:
            return sum(packed.getinfo(f"{name}.npy").file_size for name in names)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError):
        return 0  # told where it is read
