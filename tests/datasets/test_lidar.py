"""Which sweep belongs to a view, and where it lies in the scene's frame."""

from pathlib import Path

import numpy as np
import torch

from splatproof.datasets.layout import Hits, SweepFile
from splatproof.datasets.lidar import SAME_MOMENT, read_sweep, sweeps_of

FAR = np.array([2.1e4, -3e4, 40.0])


def hits() -> Hits:
    return Hits(FAR + [[1.0, 2.0, 3.0], [-0.3, 0.123, 70.0]], FAR + [0.0, 0.0, 2.0])


def file(time: float) -> SweepFile:
    return SweepFile(time=time, path=Path(f"{time}.bin"), read=hits)


def test_the_nearest_sweep_within_half_a_frame():
    first, second, late = sweeps = [file(0.0), file(0.1), file(0.4)]
    near = 0.9 * SAME_MOMENT
    times = [0.0, 0.1, near, 0.1 - near, 0.4 + near, 0.2, 0.4 + 1.1 * SAME_MOMENT, None]
    assert sweeps_of(sweeps, times) == [first, second, first, second, late, None, None, None]
    assert sweeps_of([], times) == [None] * len(times)


def test_the_first_of_two_that_are_equally_near():
    sweeps = [file(0.0), file(0.0625)]
    assert sweeps_of(sweeps, [0.03125]) == [sweeps[0]]


def test_the_shift_is_taken_off_before_digits_are():
    """Float32 resolves 2e-3 at 3e4 metres: taken off afterwards it would leave that."""
    sweep = read_sweep(file(12.5), FAR, 12.0)
    assert (sweep.time, sweep.origin.tolist()) == (0.5, [0.0, 0.0, 2.0])
    want = torch.tensor([[1.0, 2.0, 3.0], [-0.3, 0.123, 70.0]])
    assert (sweep.positions - want).abs().max() <= 70 * 2**-23  # and 4e-12 of float64 at FAR
    late = torch.from_numpy(hits().positions).float() - torch.from_numpy(FAR).float()
    assert (late - want).abs().max() > 1e-4  # control
