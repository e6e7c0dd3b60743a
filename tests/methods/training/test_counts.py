"""Counters of work: what they mean, and that no interruption changes them."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera, tiny_scene
from splatproof import _ext
from splatproof.methods.contracts.density_strategy import Frozen
from splatproof.methods.contracts.parameters import Edit
from splatproof.methods.contracts.run import Run
from splatproof.methods.kernels.rasterizer import native_camera, pairs_listed
from splatproof.methods.threedgs.fit import fit, prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.counts import Counts
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.schedules import Rates

GROWS = Settings(
    iterations=60,
    sh_degree=1,
    density=Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=10_000),
)
RUN = Run(threads=1)


class Killed(Exception):
    """Stands for a kill between two steps."""


def rows(*parents: int) -> torch.Tensor:
    return torch.tensor(parents, dtype=torch.int64)


def test_an_edit_is_rows_added_and_rows_removed():
    """Of rows 0 to 3: 0 stays and is cloned, 1 is split, 2 is pruned, 3 stays."""
    fresh = torch.tensor([False, False, True, True, True])
    edited = Counts().after_edit(Edit(parents=rows(0, 3, 0, 1, 1), fresh=fresh), 4)
    assert edited == Counts(densifications=1, rows_added=3, rows_removed=2)
    pruned = edited.after_edit(Edit(parents=rows(0, 1)), 5)
    assert pruned == Counts(densifications=2, rows_added=3, rows_removed=5)


def test_a_reset_moves_no_rows_and_new_values_alone_are_nothing():
    values = {"opacity_logits": torch.zeros(3)}
    assert Counts().after_edit(Edit(values=values), 3) == Counts()
    reset = Edit(values=values, forget=frozenset({"opacity_logits"}))
    assert Counts().after_edit(reset, 3) == Counts(resets=1)


def counted(run: Run) -> tuple[dict[str, int], int]:
    """Counters of a run that grows, and how many Gaussians it ends with."""
    found: dict[str, int] = {}
    model = fit(tiny_scene(), GROWS, replace(run, on_count=found.__setitem__))
    return found, model.primitives


def test_rows_at_the_end_are_those_at_the_start_and_what_was_added_less_what_was_removed():
    found, end = counted(RUN)
    assert found["steps"] == 60
    assert found["least_visits"] == 60 // len(tiny_scene().train)
    assert (found["densifications"], found["resets"]) == (4, 2)  # at 10 to 40; at 20 and 40
    assert found["rows_added"] > 0
    assert found["rows_removed"] > 0
    assert end == len(tiny_scene().points.positions) + found["rows_added"] - found["rows_removed"]
    assert counted(RUN) == (found, end)


def test_the_work_of_a_continued_run_is_that_of_an_undisturbed_one(tmp_path):
    def killed(step: int, total: int, values: dict[str, float]) -> None:
        if step == 30:
            raise Killed

    run = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(tiny_scene(), GROWS, replace(run, report=killed))
    assert counted(run) == counted(RUN)


def test_pairs_are_those_of_every_view_of_every_step():
    """Nothing moves, so each view has the pairs that a picture of the start has."""
    held = Rates(**dict.fromkeys(vars(Rates()), 0.0))
    still = replace(GROWS, iterations=10, views_per_step=2, rates=held)
    model, plan = prepare(tiny_scene(views=2), still, RUN)
    trainer = Trainer(model, replace(plan, density=Frozen()), RUN)
    want = 2 * 10 * pairs_of_the_start(model.parameters.rows)
    trainer.train()
    assert trainer.counts.pairs == want > 0
    by_graph = Trainer(model, replace(plan, density=Frozen(), native=False), RUN)
    by_graph.train()
    assert by_graph.counts == trainer.counts


def pairs_of_the_start(tensors: dict[str, torch.Tensor]) -> int:
    """Pairs of a picture from the one training camera, as the rasterizer's state tells them."""
    where = camera(1)
    model = _ext.Model(
        tensors["means"], tensors["quaternions"], tensors["log_scales"], tensors["opacity_logits"],
        None, tensors["sh_dc"], 1, True, False, tensors["sh_rest"],
    )  # fmt: skip
    image = torch.empty(where.height, where.width, 3)
    alpha, depth = torch.empty(2, where.height, where.width)
    before = pairs_listed()
    state = _ext.render(
        model, *native_camera(where), None, image, alpha, depth,
        torch.empty(len(tensors["means"])), None, None, None, None, None,
    )  # fmt: skip
    assert pairs_listed() - before == state.pairs
    return state.pairs


def test_a_backend_that_does_not_count_pairs_leaves_them_out():
    found, _ = counted(replace(RUN, backend="reference"))
    assert "pairs" not in found
    assert found["steps"] == 60
