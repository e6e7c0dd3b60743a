"""Gaussians as .ply files with the property names and order of the original 3DGS release."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import cast, get_args

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.ply import read_vertices, write_vertices
from splatproof.methods.models.explicit import check_gaussians
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians

SHIFT = "splatproof shift"
"""Header comment that holds the vector that was added to the means."""
MODE = "splatproof mode"
"""Header comment that holds how the model is rasterized, where that is not as in the release."""
FAR = 10_000.0
"""Scene units; float32 resolves 1e-3 there, so positions further out are centred on import."""
HIGHER_BANDS = {0: 1, 9: 4, 24: 9, 45: 16}
"""Number of f_rest properties to number of SH bands."""


def properties(bands: int) -> list[str]:
    """Names of the properties of one Gaussian, in the release's order.

    f_rest is channel-major: all higher bands of red, then of green, then of blue.

    Args:
        bands: SH coefficients of a channel, (degree + 1)^2.
    """
    return [
        "x", "y", "z", "nx", "ny", "nz",
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(3 * (bands - 1))),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]  # fmt: skip


def write_ply(
    path: str | Path,
    gaussians: Gaussians,
    shift: Float[Tensor, "3"] | None = None,
    mode: Mode = "classic",
) -> None:
    """Write a binary little-endian .ply with the raw (unconstrained) parameters; normals are 0.

    With a shift that is not zero, positions are means + shift in float64 and x, y, z are written as
    `double` (float32 is off by up to 0.25 m at UTM northings), and the header says the shift.
    Without, every property is `float`, which all viewers of the release's files open.

    Args:
        path: The file, written whole or not at all.
        gaussians: The model, in float32.
        shift: Vector in scene units, float64; added to the means it gives positions in the original
            frame. None: zero.
        mode: How the model is rasterized; "antialiased" is said in the header, for this project's
            own reading: other viewers draw every such file as the release does.

    Source: the 3DGS release's save_ply.
    """
    path = Path(path)
    offset = torch.zeros(3, dtype=torch.float64) if shift is None else shift.double()
    moved = bool((offset != 0).any())
    names = properties(gaussians.sh.shape[1])
    kinds = {name: "<f8" if moved and name in ("x", "y", "z") else "<f4" for name in names}
    rows = np.zeros(len(gaussians), dtype=list(kinds.items()))
    means = gaussians.means.double() + offset
    columns = {"x": means[:, 0], "y": means[:, 1], "z": means[:, 2],
               "opacity": gaussians.opacity_logits}  # fmt: skip
    columns |= _numbered("f_dc", gaussians.sh[:, 0])
    columns |= _numbered("f_rest", gaussians.sh[:, 1:].mT.flatten(1))
    columns |= _numbered("scale", gaussians.log_scales)
    columns |= _numbered("rot", gaussians.quaternions)
    for name, column in columns.items():
        rows[name] = column.detach().numpy()
    comments = [f"{SHIFT} {' '.join(repr(v) for v in offset.tolist())}"] if moved else []
    comments += [f"{MODE} {mode}"] if mode != "classic" else []
    write_vertices(path, rows, comments)


def read_ply(path: str | Path) -> tuple[Gaussians, Float[Tensor, "3"]]:
    """Gaussians of a .ply file, binary or ascii, of this project or another tool.

    Normals and unknown properties are ignored. The shift that the header names is taken off again
    in float64; without one, positions further out than 10,000 units lose their rounded mean.

    Args:
        path: A file with the release's properties; SH degree 0 to 3.

    Returns: The Gaussians in float32 and the float64 shift to add to their means.

    Raises: DataError, in one line, naming the file and the fault.
    """
    path = Path(path)
    found = read_vertices(path)
    vertex = found.rows
    rest = sum(name.startswith("f_rest_") for name in found.names)
    if rest not in HIGHER_BANDS:
        raise DataError(f"{path}: {rest} f_rest properties, expected 0, 9, 24 or 45")
    needed = [p for p in properties(HIGHER_BANDS[rest]) if p not in ("nx", "ny", "nz")]
    missing = [name for name in needed if name not in found.names]
    if missing:
        raise DataError(
            f"{path}: no property {missing[0]!r} ({len(missing)} missing). "
            "Expected a .ply of Gaussians, with the property names of the 3DGS release"
        )
    if not len(vertex):
        raise DataError(f"{path}: 0 vertices. Expected at least one Gaussian")
    for name in needed:
        bad = np.flatnonzero(~np.isfinite(vertex[name]))
        if len(bad):
            raise DataError(
                f"{path}: {name} of vertex {bad[0]} is {vertex[name][bad[0]]} "
                f"({len(bad)} such); remove them first"
            )

    def stack(*names: str) -> Tensor:
        columns = [np.asarray(vertex[name], dtype=np.float64) for name in names]
        return torch.from_numpy(np.stack(columns, axis=1))

    positions = stack("x", "y", "z")
    shift = _shift(path, found.comments)
    if shift is None:
        far = positions.abs().max() > FAR
        shift = positions.mean(dim=0).round() if far else torch.zeros(3, dtype=torch.float64)
    higher = stack(*(f"f_rest_{i}" for i in range(rest))) if rest else positions.new_zeros(0)
    higher = higher.reshape(len(positions), 3, -1).mT
    model = Gaussians(
        means=(positions - shift).float(),
        quaternions=stack(*(f"rot_{i}" for i in range(4))).float(),
        log_scales=stack(*(f"scale_{i}" for i in range(3))).float(),
        opacity_logits=stack("opacity")[:, 0].float(),
        sh=torch.cat([stack("f_dc_0", "f_dc_1", "f_dc_2")[:, None], higher], dim=1).float(),
    )
    check_gaussians(model, path)
    return model, shift


def read_mode(path: str | Path) -> Mode:
    """How the header of a .ply file says that its model is rasterized; "classic" where it does not.

    Raises: DataError as `read_ply`, or for a mode that there is not.
    """
    path = Path(path)
    for mode in _after(MODE, read_vertices(path).comments):
        if mode not in get_args(Mode):
            raise DataError(
                f"{path}: comment {MODE!r} says {mode!r}, expected one of {get_args(Mode)}"
            )
        return cast(Mode, mode)
    return "classic"


def _numbered(prefix: str, values: Float[Tensor, "n k"]) -> dict[str, Tensor]:
    return {f"{prefix}_{i}": column for i, column in enumerate(values.unbind(dim=1))}


def _shift(path: Path, comments: Sequence[str]) -> Float[Tensor, "3"] | None:
    """The shift that a header comment names; None if none does."""
    for numbers in _after(SHIFT, comments):
        try:
            shift = torch.tensor([float(number) for number in numbers.split()], dtype=torch.float64)
        except ValueError:
            shift = torch.zeros(0)
        if shift.shape != (3,) or not shift.isfinite().all():
            raise DataError(f"{path}: comment {SHIFT!r} says {numbers!r}, expected three numbers")
        return shift
    return None


def _after(prefix: str, comments: Sequence[str]) -> Iterator[str]:
    return (line.removeprefix(prefix).strip() for line in comments if line.startswith(prefix))
