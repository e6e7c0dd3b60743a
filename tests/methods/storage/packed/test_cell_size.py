"""Cells of positions: what is said of them is what makes them so."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import random_gaussians
from splatproof.methods.storage.packed.cell_size import NOTICED, widened
from splatproof.methods.storage.packed.coded_writer import CodeSettings, chosen_steps, write_coded
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.rows import MemoryRows
from splatproof.reference.compression.quantisers import MOST_CELL
from splatproof.reference.types.gaussians import Gaussians

SHARE = CodeSettings().position


def side(model: Gaussians) -> float:
    return chosen_steps(MemoryRows(model), CodeSettings()).position


def with_far(times: float, count: int = 1) -> Gaussians:
    """A model of which some lie so many times as far as its cells reach."""
    model = random_gaussians(300)
    model.means[:count, 2] = -times * MOST_CELL * side(model)
    return model


@pytest.mark.parametrize("count", [1, 20])
def test_far_gaussians_are_counted_and_without_them_cells_are_as_asked(count):
    model = with_far(40.0, count)
    found = widened(model, SHARE, side(model))
    assert found is not None
    assert found.times == pytest.approx(40, rel=1e-5)
    assert found.beyond == count
    assert found.farthest == model.means.abs().max()
    near = Gaussians(**{name: values[count:] for name, values in vars(model).items()})
    assert widened(near, SHARE, side(near)) is None
    assert side(near) == pytest.approx(side(model) / found.times, rel=0.1)


@pytest.mark.parametrize("times", [0.9, 0.99 * NOTICED, 1.01 * NOTICED])
def test_it_is_said_from_half_as_coarse_again_on(times):
    model = with_far(times)
    assert (widened(model, SHARE, side(model)) is not None) == (times > NOTICED)


def test_cells_that_no_position_made_large_are_not_blamed_on_one():
    model, coarse = random_gaussians(50), side(random_gaussians(50))
    shrunk = replace(model, log_scales=model.log_scales - 2)
    assert widened(shrunk, SHARE, coarse) is None
    nothing = Gaussians(**{name: values[:0] for name, values in vars(model).items()})
    assert widened(nothing, SHARE, side(nothing)) is None


def test_what_is_said_is_what_the_file_does(tmp_path):
    model = with_far(1e4)
    found = widened(model, SHARE, side(model))
    assert found is not None
    write_coded(tmp_path / "m.spgs", model)
    back, _ = read_packed(tmp_path / "m.spgs")
    near = back.means[back.means.abs().amax(dim=1) <= found.reach]
    assert len(near) == len(model) - found.beyond
    steps = near / (found.times * found.reach / MOST_CELL)
    assert torch.allclose(steps, steps.round(), atol=1e-3)
    assert len(near.unique(dim=0)) < len(near) / 2
