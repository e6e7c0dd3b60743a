"""Several views a step: the mean of their gradients, counted by density control, resumable."""

from dataclasses import replace

import pytest
import torch

from helpers.killed_run import assert_continues
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.optimizer import Adam

SETTINGS = Settings(
    iterations=40, sh_degree=1, views_per_step=3, dropout=0.2, random_background=True,
    density=Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=0),
)  # fmt: skip
RUN = Run(backend="cpu", threads=1)


def started() -> Trainer:
    """A trainer at step 0."""
    return Trainer(*prepare(tiny_scene(), SETTINGS, RUN), RUN)


@pytest.mark.parametrize("native", [True, False])
def test_a_step_follows_the_mean_of_its_views(native: bool):
    """Against gradients that are taken view by view and averaged by hand, draw for draw."""
    trainer, other = started(), started()
    trainer.native = other.native = native
    other.step = 1
    tensors = other.model.parameters.trained
    losses, sums = [], {n: torch.zeros_like(v) for n, v in tensors.items()}
    for _ in range(3):
        values, _ = other.backward(other.plan.views[other.order.next(other.generator)])
        losses.append(values["loss"])
        for name, value in tensors.items():
            if value.grad is not None:
                sums[name] += value.grad
                value.grad = None
    by_hand = Parameters({n: v.detach() for n, v in tensors.items()})
    for name, value in by_hand.rows.items():
        value.grad = sums[name] / 3
    Adam(by_hand).step(other.rates())
    assert trainer.advance()["loss"] == pytest.approx(sum(losses) / 3, rel=1e-6)
    for name, value in trainer.model.parameters.trained.items():
        assert torch.equal(value.detach(), by_hand.rows[name].detach()), name


def test_density_control_counts_every_view():
    trainer = started()
    trainer.advance()
    assert float(trainer.plan.density.state()["seen"].max()) == 3


def test_a_killed_run_continues_bit_for_bit(tmp_path):
    assert_continues(SETTINGS, RUN, 20, tmp_path)


def test_no_view_a_step_is_refused():
    with pytest.raises(UsageError, match="views_per_step"):
        replace(SETTINGS, views_per_step=0)
