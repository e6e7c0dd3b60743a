"""Several views a step: the mean of their gradients, counted by density control, resumable."""

from dataclasses import replace

import pytest
import torch

from helpers.killed_run import assert_continues
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.backends import get_backend
from splatproof.methods.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.optimizer import Adam

SETTINGS = Settings(
    iterations=40, sh_degree=1, views_per_step=3, dropout=0.2, random_background=True,
    density=Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=0),
)  # fmt: skip
RUN = Run(backend="cpu", threads=1)


@pytest.mark.parametrize("native", [True, False])
def test_a_step_follows_the_mean_of_its_views(native: bool):
    """Against gradients that are taken view by view and averaged by hand, draw for draw."""
    trainer, other = (Trainer(tiny_scene(), SETTINGS, RUN, get_backend("cpu")) for _ in range(2))
    trainer.renders_parameters = other.renders_parameters = native
    other.step = 1
    losses, sums = [], {n: torch.zeros_like(v) for n, v in other.adam.parameters.items()}
    for _ in range(3):
        other.adam.leaves()
        loss, _, _ = other.backward(other.views[other.next_view()])
        losses.append(loss)
        for name, value in other.adam.parameters.items():
            if value.grad is not None:
                sums[name] += value.grad
                value.grad = None
    by_hand = Adam({n: v.detach() for n, v in other.adam.parameters.items()})
    for name, value in by_hand.parameters.items():
        value.grad = sums[name] / 3
    by_hand.step(other.learning_rates())
    assert trainer.advance() == pytest.approx(sum(losses) / 3, rel=1e-6)
    for name, value in trainer.adam.parameters.items():
        assert torch.equal(value.detach(), by_hand.parameters[name].detach()), name


def test_density_control_counts_every_view():
    trainer = Trainer(tiny_scene(), SETTINGS, RUN, get_backend("cpu"))
    trainer.advance()
    assert float(trainer.control.seen.max()) == 3


def test_a_killed_run_continues_bit_for_bit(tmp_path):
    assert_continues(SETTINGS, RUN, 20, tmp_path)


def test_no_view_a_step_is_refused():
    with pytest.raises(UsageError, match="views_per_step"):
        replace(SETTINGS, views_per_step=0)
