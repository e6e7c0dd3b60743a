"""The small file, version 3 of the packed file: codes of Gaussians, entropy-coded, streamed.

Layout (records): a header in JSON, then chunks. Gaussians are in the order of the Morton curve
through the cells of their positions. A chunk holds, for each of coded_chunk.PARTS, its length in
bytes (u32) and a stream. The reference is in reference.compression: quantisers, gaps, columns and
harmonics.
"""

import json
import os
import struct
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import whole_file
from splatproof.methods.kernels import codec
from splatproof.methods.storage.packed.cell_size import asked_cell, least_cell
from splatproof.methods.storage.packed.coded_chunk import PARTS, Profile, quantise, write_streams
from splatproof.methods.storage.packed.records import CODED, RecordWriter
from splatproof.methods.storage.packed.rows import MemoryRows, Rows
from splatproof.methods.storage.packed.writer import (
    FORMAT,
    NAMES,
    PackedFacts,
    PackedReport,
    in_order,
)
from splatproof.reference.compression import quantisers
from splatproof.reference.compression.quantisers import FRACTION, Steps
from splatproof.reference.types.gaussians import Gaussians

CHUNK: dict[Profile, int] = {"small": 2**15, "fast": 2**16}
"""Gaussians of a chunk, at the most; all but the last are equally large. Each is coded anew, on a thread
of its own: twice as many save 0.4 to 0.5 % of a small file and 0.9 to 1.5 % of a fast one
(brighton_beach, seneca and courtyard), and keep half as many cores busy."""
LOOKED = 2**16
"""Gaussians that the steps and the order are found of at a time."""
SENSITIVITY = (0.64, -0.08, -0.23, 0.24, 0.76)
"""What half the binary logarithm of a Gaussian's visibility (visibility.squares) grows by with its
opacity logit, the square of that, and its smallest, middle and largest log scale: least squares on
models of brighton_beach, seneca and courtyard of 1,500 steps, the mean of the three. Each explains
within 0.02 as much of the others (R^2 0.56, 0.34 and 0.72) as their own would."""
POWER = 0.5
"""A step grows as visibility^(-POWER / 2): 1 would be equal cost if visibility were known."""


@dataclass(frozen=True, kw_only=True)
class CodeSettings:
    """How finely a model is stored."""

    profile: Profile = "small"
    """How codes become bytes. small: contexts are mixed; fast: by zstd, read several times as fast
    and a quarter larger at the most that was measured (docs/size.md)."""
    position: float = 0.05
    """Side of a cell as a share of the median Gaussian's middle scale."""
    log_scale: float = 0.1
    """Step of the natural logarithm of a scale."""
    opacity: float = 0.1
    """Step of the opacity logit."""
    rotation_bits: int = 6
    """Bits of each of a rotation's three stored components, 4 to 12."""
    dc: float = 0.05
    """Step of SH coefficient 0."""
    harmonics: float = 0.04
    """Step of the other SH coefficients of a Gaussian that is seen as much as the median one; the
    class of the others makes it 1/8 to 8 times as large."""

    def __post_init__(self) -> None:
        """Refuse settings that no file can be written with."""
        for name in ("position", "log_scale", "opacity", "dc", "harmonics"):
            if not 1e-6 <= getattr(self, name) <= 1e3:
                raise DataError(f"{name} {getattr(self, name)}: expected 1e-6 to 1000")
        if not 4 <= self.rotation_bits <= 12:
            raise DataError(f"rotation_bits {self.rotation_bits}: expected 4 to 12")


QUALITIES = {
    "fine": CodeSettings(
        position=0.025, log_scale=0.05, opacity=0.05, rotation_bits=8, dc=0.03, harmonics=0.015
    ),
    "standard": CodeSettings(),
    "coarse": CodeSettings(dc=0.08, harmonics=0.1),
}
"""Settings by name, chosen on training views of brighton_beach, seneca and courtyard: `bench study size`
says what each costs."""


def write_coded(
    path: str | Path,
    source: Gaussians | Rows,
    *,
    settings: CodeSettings | None = None,
    steps: Steps | None = None,
    facts: PackedFacts | None = None,
    threads: int | None = None,
) -> PackedReport:
    """Write a small file, reading the source twice: once for the steps and order, once in file order.

    Held at once: 28 bytes a Gaussian, and a few chunks.

    Args:
        path: The file, written whole or not at all.
        source: Gaussians in memory, or rows of a model folder (FolderRows).
        settings: How finely it is stored, and in which profile; None: the defaults.
        steps: The steps themselves, as a file says them; None: those that the settings give this
            model.
        facts: What is needed to draw and export it; None: the defaults.
        threads: Number of threads that pack; None: one for each core. The bytes do not depend on
            it.

    Raises: DataError for numbers that are not finite or beyond their grid.

    Source: ours.
    """
    path = Path(path)
    start = time.perf_counter()
    settings, facts = settings or CodeSettings(), facts or PackedFacts()
    rows = MemoryRows(source) if isinstance(source, Gaussians) else source
    steps = steps or chosen_steps(rows, settings)
    corner, order = file_order(rows, steps)
    size = chunk_size(len(rows), settings.profile)
    header = {
        "format": FORMAT,
        "primitives": len(rows),
        "bands": rows.bands,
        "chunk": size,
        "packing": asdict(settings),
        "steps": asdict(steps),
        "corner": corner.tolist(),
        "mode": facts.mode,
        "shift": facts.shift.tolist(),
        "units": facts.units,
        **asdict(facts.origin),
    }
    sizes, opened = dict.fromkeys(PARTS, 0), 0

    def chunk(first: int) -> tuple[list[bytes], int]:
        model = Gaussians(**rows.take(order[first : first + size], NAMES))
        codes = quantise(model, steps, corner)
        return write_streams(codes, steps, settings.profile), int(codes.rest.any(axis=0).sum())

    with whole_file(path) as partial, partial.open("wb") as file:
        out = RecordWriter(file, CODED)
        out.add(json.dumps(header, sort_keys=True).encode())
        each = in_order(chunk, range(0, len(rows), size), threads or os.cpu_count() or 1)
        for streams, colourful in each:
            opened += colourful
            for name, stream in zip(PARTS, streams, strict=True):
                sizes[name] += len(stream)
            out.add(b"".join(struct.pack("<I", len(s)) + s for s in streams))
        total = file.tell()
    return PackedReport(
        primitives=len(rows), open_share=opened / max(len(rows), 1),
        bytes_by_part=sizes | {"frame": total - sum(sizes.values())},
        seconds=time.perf_counter() - start,
    )  # fmt: skip


def chunk_size(count: int, profile: Profile) -> int:
    """Gaussians of a chunk: as few chunks as CHUNK allows, equally large but for the last.

    Args:
        count: Gaussians of the model.
        profile: How codes become bytes.
    """
    most = CHUNK[profile]
    return -(-count // max(1, -(-count // most))) or most


def chosen_steps(rows: Rows, settings: CodeSettings) -> Steps:
    """The steps that settings give a model.

    A cell is the set share of the median Gaussian's middle scale, or what brings the farthest
    position onto the grid. The class of the median Gaussian is the middle one.

    Args:
        rows: The model.
        settings: How finely it is to be stored.

    Raises: DataError for numbers that are not finite or beyond their grid.
    """
    scales, felt, reach = [], [], 0.0
    units = (settings.opacity, settings.opacity**2, *[settings.log_scale] * 3)
    slopes = zip(SENSITIVITY, units, strict=True)
    weights = [0, *(round(-POWER * slope * unit * 2**FRACTION) for slope, unit in slopes)]
    for first in range(0, len(rows), LOOKED):
        part = rows.take(slice(first, first + LOOKED), ("means", "log_scales", "opacity_logits"))
        log_scales = part["log_scales"].double().numpy()
        means = part["means"].double().numpy()
        if not np.isfinite(means).all():
            raise DataError("positions are not all finite: clean the model first")
        reach = max(reach, float(np.abs(means).max()))
        codes = quantisers.uniform("log scale", log_scales, settings.log_scale)
        logits = part["opacity_logits"].double().numpy()
        most = quantisers.MOST_LOGIT
        opacity = quantisers.uniform(
            "opacity logit", np.nan_to_num(logits).clip(-most, most), settings.opacity
        )
        scales.append(np.median(log_scales, axis=1))
        felt.append(quantisers.weighed(codes, opacity, tuple(weights)))
    if felt:
        weights[0] = -int(np.median(np.concatenate(felt)))
    asked = asked_cell(np.concatenate(scales) if scales else np.zeros(0), settings.position)
    return Steps(
        position=max(asked, least_cell(reach)), log_scale=settings.log_scale,
        opacity=settings.opacity, rotation_bits=settings.rotation_bits, dc=settings.dc,
        harmonics=settings.harmonics, weights=tuple(weights),
    )  # fmt: skip


def with_room(steps: Steps, rows: Rows) -> Steps:
    """The same steps with cells that bring the farthest position onto the grid, if theirs do not.

    Args:
        steps: Chosen for a model before its Gaussians moved.
        rows: The model as it is to be stored.

    Raises: DataError for positions that are not finite.

    Source: ours.
    """
    reach = 0.0
    for first in range(0, len(rows), LOOKED):
        means = rows.take(slice(first, first + LOOKED), ("means",))["means"]
        if not bool(means.isfinite().all()):
            raise DataError("positions are not all finite: clean the model first")
        reach = max(reach, float(means.double().abs().max()))
    return replace(steps, position=max(steps.position, least_cell(reach)))


def file_order(rows: Rows, steps: Steps) -> tuple[Int64[np.ndarray, "3"], Int64[Tensor, " n"]]:
    """Lowest cell of each axis, and the Gaussians in the order of the file; in that order they keep it.

    Args:
        rows: The model.
        steps: The file's.
    """
    found = np.empty((len(rows), 3), dtype=np.int32)
    for first in range(0, len(rows), LOOKED):
        means = rows.take(slice(first, first + LOOKED), ("means",))["means"].double().numpy()
        found[first : first + LOOKED] = quantisers.cells(means, steps.position)
    corner = found.min(axis=0) if len(found) else np.zeros(3, dtype=np.int32)
    found -= corner
    order = codec.morton_of_cells(found).argsort(kind="stable")
    return corner.astype(np.int64), torch.from_numpy(order)
