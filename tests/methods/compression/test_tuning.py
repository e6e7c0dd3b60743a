"""Training through the file's steps: the loss falls, bits fall with their price, runs continue."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.compression.tuning import TuneSettings, tuned
from splatproof.methods.contracts.run import Run
from splatproof.methods.storage.packed.coded_writer import CodeSettings, chosen_steps, write_coded
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.rows import MemoryRows
from splatproof.methods.training.schedules import Rates
from splatproof.reference.compression.quantisers import MOST_CELL
from splatproof.reference.types.gaussians import Gaussians

SCENE = tiny_scene(views=5)
RUN = Run(threads=1)
KEPT = CodeSettings(harmonics=0.1, dc=0.1)


def spoilt() -> Gaussians:
    truth = random_gaussians(40)
    return replace(truth, sh=truth.sh + 0.2, opacity_logits=truth.opacity_logits - 0.5)


def after(steps: int, folder: Path | None = None, rate: float = 0.0):
    losses: list[float] = []
    run = replace(RUN, folder=folder, report=lambda step, total, v: losses.append(v["photometric"]))
    grid = chosen_steps(MemoryRows(spoilt()), KEPT)
    settings = TuneSettings(iterations=steps, rate=rate, rates=Rates(sh_rest=0.02, settle=0.1))
    return tuned(spoilt(), SCENE, grid, settings, run, "classic"), grid, losses


def test_the_loss_falls_and_the_file_loses_nothing_more(tmp_path):
    found, grid, losses = after(80)
    assert losses[-1] < 0.8 * losses[0]
    write_coded(tmp_path / "m", found, settings=KEPT, steps=grid)
    back = read_packed(tmp_path / "m")[0]
    for name, values in vars(found).items():
        mine, its = (part.reshape(len(part), -1) for part in (values, getattr(back, name)))
        near = torch.cdist(mine.double(), its.double()).amin(dim=1)  # the file has its own order
        assert near.max() < 1e-4, name


def test_what_training_moves_beyond_the_grid_is_stored_on_its_edge(tmp_path):
    """Cells are as small as the farthest Gaussian allows, and then a rate throws it outward."""
    start, settings = spoilt(), CodeSettings(position=1e-6)
    grid = chosen_steps(MemoryRows(start), settings)
    rates = Rates(means=0.05, means_final=0.05)
    found = tuned(start, SCENE, grid, TuneSettings(iterations=20, rates=rates), RUN, "classic")
    assert not torch.equal(found.means, start.means)
    write_coded(tmp_path / "m", found, settings=settings, steps=grid)
    assert float(found.means.abs().max()) <= grid.position * MOST_CELL * (1 + 1e-6)


def test_a_price_of_bits_makes_the_file_smaller(tmp_path):
    sizes = []
    for rate in (0.0, 0.02):
        found, grid, _ = after(80, rate=rate)
        report = write_coded(tmp_path / "m", found, settings=KEPT, steps=grid)
        sizes.append(report.bytes_by_part["rest"])
    assert sizes[1] < 0.8 * sizes[0]


def test_a_run_that_was_ended_continues_to_the_same_model(tmp_path):
    whole, *_ = after(20, tmp_path / "a")

    class Ended(Exception):
        pass

    def end(step, total, values):
        if step >= 10:
            raise Ended

    grid = chosen_steps(MemoryRows(spoilt()), KEPT)
    settings = TuneSettings(iterations=20, rate=0.0, rates=Rates(sh_rest=0.02, settle=0.1))
    run = replace(RUN, folder=tmp_path / "b", report=end, checkpoint_seconds=0.0)
    with pytest.raises(Ended):
        tuned(spoilt(), SCENE, grid, settings, run, "classic")
    found, *_ = after(20, tmp_path / "b")
    for name, values in vars(whole).items():
        assert torch.equal(getattr(found, name), values), name


@pytest.mark.parametrize(("name", "value"), [("iterations", 0), ("rate", -1.0), ("rate", 2.0)])
def test_settings_that_no_run_can_follow_are_refused(name, value):
    with pytest.raises(UsageError, match=name):
        TuneSettings(**{name: value})
