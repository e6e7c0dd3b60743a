"""Hard cases of the packed file's steps and of the coders that write its codes."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from splatproof.reference.compression import columns, gaps, harmonics, logistic, merging, quantisers
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.hard_cases.case import HardCase, drawn, fixed

LAST = 2.0**21 - 1
"""The largest cell number along an axis."""


def _numbers(codes: np.ndarray) -> Tensor:
    return torch.from_numpy(codes.astype(np.float64))


def _gaps(damage: Callable[[bytes], bytes] = bytes) -> Callable[[Tensor], Tensor]:
    """Cells along the curve and back."""

    def run(cells: Tensor) -> Tensor:
        codes = gaps.morton_of_cells(cells.numpy().astype(np.int32))
        data = damage(gaps.encode_gaps(codes))
        return _numbers(gaps.cells_of_morton(gaps.decode_gaps(data, len(codes))))

    return run


def _near(cells: Tensor) -> Tensor:
    return _numbers(gaps.nearest_before(cells.numpy().astype(np.int32)))


def _columns(bits: int, damage: Callable[[bytes], bytes] = bytes) -> Callable[[Tensor], Tensor]:
    """Two equal columns of codes, of which each next one has the three before as its nearest."""

    def run(codes: Tensor) -> Tensor:
        both, width = _twice(codes), np.full(2, bits, dtype=np.int32)
        near, side = _chain(len(codes)), np.zeros(len(codes), dtype=np.int32)
        data = damage(columns.encode_columns(both, width, near, side))
        return _numbers(columns.decode_columns(data, width, near, side))

    return run


def _harmonics(damage: Callable[[bytes], bytes] = bytes) -> Callable[[Tensor], Tensor]:
    """Three equal columns of signed codes."""

    def run(codes: Tensor) -> Tensor:
        near, found = _chain(len(codes)), np.full(len(codes), 3, dtype=np.int32)
        three = np.concatenate([_twice(codes), _twice(codes)[:1]])
        data = damage(harmonics.encode_harmonics(three, near, found))
        return _numbers(harmonics.decode_harmonics(data, 3, near, found))

    return run


def _twice(codes: Tensor) -> np.ndarray:
    return np.stack([codes.numpy().astype(np.int32)] * 2)


def _chain(count: int) -> np.ndarray:
    before = np.arange(count, dtype=np.int32)[:, None] - np.arange(1, 4, dtype=np.int32)
    return np.maximum(before, -1).astype(np.int32)


def _made_again(_: Tensor) -> Tensor:
    """How far tables that are made once more lie from those in use."""
    again = logistic.squash.__wrapped__()
    return _numbers(again - logistic.squash())


def _cells(means: Tensor) -> Tensor:
    return _numbers(quantisers.cells(means.double().numpy(), 1e-3)) * 1e-3


def _rotations(quaternions: Tensor) -> Tensor:
    codes = quantisers.rotation_codes(quaternions.double().numpy(), 9)
    return torch.from_numpy(quantisers.rotations(codes, 9))


def _coloured(rest: Tensor) -> Tensor:
    found = np.full(len(rest), 3, dtype=np.int32)
    codes = quantisers.harmonic_codes(rest.double().numpy(), found, 0.02)
    return torch.from_numpy(quantisers.harmonics(codes, found, 0.02))


def _one_of_two(log_scales: Tensor) -> Tensor:
    """Scales of two Gaussians at one place that became one: those of each, where they are equal."""
    count = len(log_scales)
    both = Gaussians(
        means=torch.zeros(count, 3), quaternions=torch.eye(4)[:1].repeat(count, 1), log_scales=log_scales,
        opacity_logits=torch.zeros(count), sh=torch.zeros(count, 1, 3),
    )  # fmt: skip
    pairs, mass = torch.tensor([[0, 1]]), torch.ones(count)
    chosen = merging.matched(pairs, merging.costs(both, pairs, mass), 1)
    found, _ = merging.merged(both, chosen, mass)
    return found.log_scales.sort(dim=1).values


NOTHING = fixed(torch.zeros(1))
COUNTED = fixed(torch.arange(16.0))

CASES = (
    HardCase(component="gaps", name="no Gaussian", inputs=fixed(torch.zeros(0, 3)), run=_gaps()),
    HardCase(component="gaps", name="all in one cell", inputs=fixed(torch.full((50, 3), 7.0)),
             run=_gaps()),
    HardCase(component="gaps", name="first and last cell of the grid",
             inputs=fixed(torch.tensor([[0.0] * 3, [LAST] * 3])), run=_gaps()),
    HardCase(component="gaps", name="not sorted",
             inputs=fixed(torch.tensor([[9.0] * 3, [1.0] * 3])), run=_gaps(), expect="refused"),
    HardCase(component="gaps", name="empty stream", inputs=fixed(torch.ones(3, 3)),
             run=_gaps(lambda _: b""), expect="refused"),
    HardCase(component="gaps", name="bytes after the stream", inputs=fixed(torch.ones(3, 3)),
             run=_gaps(lambda data: data + b"\0" * 8), expect="refused"),
    HardCase(component="gaps", name="leaves the grid", inputs=fixed(torch.ones(9, 3)),
             run=_gaps(lambda data: b"\0" * 64), expect="refused"),
    HardCase(component="gaps", name="nearest of equals", inputs=fixed(torch.zeros(200, 3)),
             run=_near),
    HardCase(component="columns", name="no bits", inputs=fixed(torch.zeros(16)), run=_columns(0)),
    HardCase(component="columns", name="widest codes", inputs=fixed(torch.full((16,), 4095.0)),
             run=_columns(12)),
    HardCase(component="columns", name="nothing repeats", inputs=COUNTED, run=_columns(4)),
    HardCase(component="columns", name="empty stream", inputs=COUNTED,
             run=_columns(4, lambda _: b""), expect="refused"),
    HardCase(component="harmonics", name="all 0", inputs=fixed(torch.zeros(100)),
             run=_harmonics()),
    HardCase(component="harmonics", name="one of 2^20 among zeros",
             inputs=fixed(torch.tensor([0.0] * 40 + [-(2.0**20)] + [0.0] * 40)), run=_harmonics()),
    HardCase(component="harmonics", name="empty stream", inputs=COUNTED,
             run=_harmonics(lambda _: b""), expect="refused"),
    HardCase(component="logistic", name="made again", inputs=NOTHING, run=_made_again),
    HardCase(component="merging", name="two of one shape",
             inputs=fixed(torch.tensor([[-3.0, -2.0, -1.0]] * 2)), run=_one_of_two),
    HardCase(component="merging", name="two flat ones", inputs=fixed(torch.tensor([[-12.0, 0, 0]] * 2)),
             run=_one_of_two),
    HardCase(component="merging", name="no volume at all",
             inputs=fixed(torch.full((2, 3), -400.0)), run=_one_of_two),
    HardCase(component="quantisers", name="positions at the ends of the grid",
             inputs=fixed(torch.tensor([[1e-3, -1e-3, 0.0]]) * (2**20 - 1)), run=_cells),
    HardCase(component="quantisers", name="a position beyond the grid",
             inputs=fixed(torch.tensor([[1e-3, 0.0, 0.0]]) * 2**20), run=_cells, expect="refused"),
    HardCase(component="quantisers", name="NaN position",
             inputs=fixed(torch.full((1, 3), torch.nan)), run=_cells, expect="refused"),
    HardCase(component="quantisers", name="quaternion 0", inputs=fixed(torch.zeros(2, 4)),
             run=_rotations),
    HardCase(component="quantisers", name="quaternions of length 1e-20 and 1e20",
             inputs=fixed(torch.tensor([[1.0, 2, 3, 4]]) * torch.tensor([[1e-20], [1e20]])),
             run=_rotations),
    HardCase(component="quantisers", name="infinite quaternion",
             inputs=fixed(torch.full((1, 4), torch.inf)), run=_rotations, expect="refused"),
    HardCase(component="quantisers", name="drawn colours", inputs=drawn(0, (20, 15, 3)),
             run=_coloured, budget=6e-3),  # numbers half-way between codes go either way in float32
    HardCase(component="quantisers", name="infinite SH",
             inputs=fixed(torch.full((1, 3, 3), torch.inf)), run=_coloured, expect="refused"),
)  # fmt: skip
