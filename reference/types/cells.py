"""Rows of whole numbers, such as the cells of a grid, each kind once."""

import torch
from jaxtyping import Int
from torch import Tensor

_MOST = 2**62
"""Numbers that one row may become, so that none overflows 64 bits."""


def unique_rows(rows: Int[Tensor, "n k"]) -> tuple[Int[Tensor, "m k"], Int[Tensor, " n"]]:
    """Each kind of row once in lexicographic order, and which kind each row is of.

    As torch.unique(rows, dim=0, return_inverse=True), which is ten times slower: where the rows span
    fewer than 2^62 cells each is made one number, in the same order.

    Args:
        rows: Whole numbers of any sign.

    Source: ours.
    """
    if rows.numel() == 0:
        return torch.unique(rows, dim=0, return_inverse=True)
    low = rows.amin(dim=0)
    spans = [
        high - least + 1
        for high, least in zip(rows.amax(dim=0).tolist(), low.tolist(), strict=True)
    ]
    cells = 1
    for span in spans:
        cells *= span
    if cells > _MOST:
        return torch.unique(rows, dim=0, return_inverse=True)
    number = torch.zeros_like(rows[:, 0])
    for column, span in zip((rows - low).unbind(dim=1), spans, strict=True):
        number = number * span + column
    kinds, which = torch.unique(number, return_inverse=True)
    columns = []
    for span in reversed(spans):
        columns.append(kinds % span)
        kinds = kinds // span
    return torch.stack(columns[::-1], dim=1) + low, which
