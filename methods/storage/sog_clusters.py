"""Palette and codebooks of .sog: Lloyd's k-means that draws nothing."""

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int64, UInt8
from torch import Tensor

LEVELS = 256
"""Entries of a codebook: a label is a byte."""
ROUNDS, CELL_ROUNDS = 10, 5
"""Rounds of Lloyd's for the palette, as the format's own encoder takes, and for its cells."""
NEAR = 8
"""Cells whose entries a row is held against. Mean squared distance of 24,440 trained Gaussians of degree 3 to 4,096
entries: 0.01282 with 8 cells in 7 s, 0.01310 with 4 in 5 s, 0.01376 with 1 in 3 s. Against all entries it is 0.01318
after 10 rounds from evenly spaced rows and 0.01299 after 5 from the result with 1 cell, in 44 s each. Of 119,977
Gaussians and 65,536 entries all that is here takes 64 s; to ask all entries once more takes 691 s and gains 1.5 %."""
MOST_CODEBOOK_ROUNDS = 300
"""Rounds of a codebook at the most; they end earlier where nothing moves."""
AT_ONCE = 2048
"""Rows that are held against entries at a time."""


def clustered(
    rows: Float32[Tensor, "n d"], count: int
) -> tuple[Float32[Tensor, "k d"], Int64[Tensor, " n"]]:
    """Entries of a palette and the entry of each row: Lloyd's k-means among the entries of near cells.

    Rows are cut into about sqrt(count) cells by k-means from evenly spaced rows. First entries are rows at equal steps
    of the squared distances to the cells' centres, added up cell by cell: many where the error is. A row then looks
    at the entries of the NEAR cells nearest to its own. An entry that no row chose is put on a row that is farthest
    from its own.

    Args:
        rows: What is clustered, at least one, in an order in which neighbours are alike.
        count: Entries at the most, at least 1; no more than rows are made.
    Returns: Entries, those of a cell one after another, and labels.

    Source: Lloyd 1982, "Least squares quantization in PCM"; cells: Jegou et al. 2011, "Product quantization for nearest
        neighbor search", Sec. IV; seeds at equal steps of the error: ours.
    """
    if count >= len(rows):
        return rows.clone(), torch.arange(len(rows))
    # a power of two changes no digit, and squares of numbers about 1 are finite
    power = torch.frexp(rows.abs().max()).exponent.clamp(-100, 100)
    rows = torch.ldexp(rows, -power)
    centres = rows[_even(len(rows), max(1, round(count**0.5)))]
    for _ in range(CELL_ROUNDS):
        centres = _moved(rows, nearest(rows, centres), centres)
    cells = nearest(rows, centres)
    order = cells.argsort(stable=True)
    rows, cells = rows[order], cells[order]
    seeds = _seeds((rows - centres[cells]).square().sum(dim=1).double(), count)
    entries = rows[seeds]
    starts, ends = _spans(cells, len(centres)), _spans(cells[seeds], len(centres))
    near = torch.cdist(centres, centres).topk(min(NEAR, len(centres)), largest=False).indices
    choices = [torch.cat([torch.arange(*ends[one]) for one in some]) for some in near.tolist()]

    def labelled() -> Int64[Tensor, " n"]:
        found = torch.empty_like(cells)
        for (first, last), choice in zip(starts, choices, strict=True):
            asked = choice if len(choice) else torch.arange(count)  # equal rows may have no seed
            found[first:last] = asked[nearest(rows[first:last], entries[asked])]
        return found

    for _ in range(ROUNDS):
        entries = _moved(rows, labelled(), entries)
    labels = torch.empty_like(cells)
    labels[order] = labelled()
    return torch.ldexp(entries, power), labels


def nearest(rows: Float32[Tensor, "n d"], entries: Float32[Tensor, "k d"]) -> Int64[Tensor, " n"]:
    """The entry nearest to each row.

    Args:
        rows: What is asked about.
        entries: At least one.
    """
    half = entries.square().sum(dim=1) / 2
    labels = torch.empty(len(rows), dtype=torch.int64)
    for first in range(0, len(rows), AT_ONCE):
        part = rows[first : first + AT_ONCE]
        labels[first : first + AT_ONCE] = torch.addmm(half, part, entries.T, alpha=-1).argmin(dim=1)
    return labels


def codebook(values: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "256"]:
    """Levels of numbers, in rising order: k-means in one dimension, to its end.

    First levels are at equal steps of the gaps between neighbours to the power 2/3, which is where many levels of the
    least squared error lie. Numbers of at most 256 values have just these.

    Args:
        values: Finite numbers, at least one.

    Source: Lloyd 1982, "Least squares quantization in PCM"; first levels: Panter and Dite 1951, "Quantization distortion
        in pulse-count modulation with nonuniform spacing of levels" (density to the power 1/3).
    """
    found = np.sort(values, axis=None).astype(np.float64)
    gaps = np.diff(found)
    different = np.concatenate([found[:1], found[1:][gaps > 0]])
    if len(different) <= LEVELS:
        return np.pad(different, (0, LEVELS - len(different)), mode="edge").astype(np.float32)
    reached = np.concatenate([[0.0], np.cumsum(gaps ** (2 / 3))])
    levels = np.interp((np.arange(LEVELS) + 0.5) / LEVELS * reached[-1], reached, found)
    for _ in range(MOST_CODEBOOK_ROUNDS):
        ends = np.searchsorted(found, (levels[1:] + levels[:-1]) / 2)
        starts = np.concatenate([[0], ends])
        counts = np.diff(np.concatenate([starts, [len(found)]]))
        taken = counts > 0
        moved = levels.copy()
        moved[taken] = np.add.reduceat(found, starts[taken]) / counts[taken]
        if np.array_equal(moved, levels):
            break
        levels = np.sort(moved)
    return levels.astype(np.float32)


def labels_of(
    values: Float32[np.ndarray, "*shape"], levels: Float32[np.ndarray, "256"]
) -> UInt8[np.ndarray, "*shape"]:
    """The level nearest to each number.

    Args:
        values: Numbers of any shape.
        levels: What `codebook` returned.
    """
    known = levels.astype(np.float64)
    return np.searchsorted((known[1:] + known[:-1]) / 2, values).astype(np.uint8)


def _even(size: int, count: int) -> Int64[Tensor, " k"]:
    """So many places of a row, evenly spaced."""
    return torch.linspace(0, size - 1, count, dtype=torch.float64).long()


def _seeds(errors: Float64[Tensor, " n"], count: int) -> Int64[Tensor, " k"]:
    """Different places of a row, rising, at equal steps of the errors added up; fewer than there are errors."""
    total = errors.sum()
    # some for rows that are alike, and where all are
    reached = (errors + errors.mean() / 1000 if total > 0 else torch.ones_like(errors)).cumsum(0)
    steps = torch.arange(count)
    at = torch.searchsorted(reached, (steps + 0.5) / count * reached[-1])
    at = (at - steps).cummax(dim=0).values + steps
    return at.minimum(len(errors) - count + steps)


def _spans(cells: Int64[Tensor, " n"], count: int) -> list[tuple[int, int]]:
    """First place and the one after the last of each cell in a sorted row of cells."""
    ends = torch.bincount(cells, minlength=count).cumsum(0).tolist()
    return list(zip([0, *ends[:-1]], ends, strict=True))


def _moved(
    rows: Float32[Tensor, "n d"], labels: Int64[Tensor, " n"], entries: Float32[Tensor, "k d"]
) -> Float32[Tensor, "k d"]:
    """The mean of each entry's rows; entries without any on the rows that are farthest from theirs."""
    sizes = torch.bincount(labels, minlength=len(entries))[:, None]
    sums = torch.zeros_like(entries).index_add_(0, labels, rows)
    moved = torch.where(sizes > 0, sums / sizes.clamp(min=1), entries)
    empty = torch.where(sizes[:, 0] == 0)[0]
    if len(empty):
        off = (rows - moved[labels]).square().sum(dim=1)
        moved[empty] = rows[off.argsort(descending=True, stable=True)[: len(empty)]]
    return moved
