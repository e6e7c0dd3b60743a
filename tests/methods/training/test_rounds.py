"""Trainings that follow each other in one run: rounds of one length, each as a run of that length."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.killed_run import assert_continues
from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.auto.recount import Recount
from splatproof.methods.contracts.model import Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.sparse_views import cor_gs, fsgs
from splatproof.methods.stratosplat import fit as stratosplat
from splatproof.methods.stratosplat.settings import Planes, StratoSplat
from splatproof.methods.threedgs import mip_splatting
from splatproof.methods.threedgs.density import StrategicDensity
from splatproof.methods.threedgs.fit import fit, prepare
from splatproof.methods.threedgs.mip_splatting import MipSettings
from splatproof.methods.threedgs.settings import Settings, ThreeDGS
from splatproof.methods.training.density import Density
from splatproof.methods.training.density_control import DensityControl
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.optimizer import Adam
from splatproof.methods.training.schedules import Rates, restarts, round_of

RUN = Run(threads=1, seed=3)
GROWS = Settings(
    iterations=60, rounds=2, sh_degree=1, rates=Rates(settle=0.1),
    density=Density(start=0, interval=1, least_interval=5, reset_interval=0, gradient=0.0, least_opacity=0.0),
)  # fmt: skip
"""Densified at 5 and 10, and at 35 and 40."""


def trainer_of(settings: Settings) -> Trainer:
    model, plan = prepare(tiny_scene(), settings, RUN)
    return Trainer(model, plan, RUN)


@given(iterations=st.integers(1, 60_000), rounds=st.integers(1, 9))
def test_rounds_fill_a_run_and_only_the_last_is_shorter(iterations, rounds):
    begun = (0, *restarts(iterations, rounds))
    lengths = [b - a for a, b in zip(begun, (*begun[1:], iterations), strict=True)]
    assert sum(lengths) == iterations
    assert len(lengths) <= rounds
    assert len(set(lengths[:-1])) <= 1
    assert 0 < lengths[-1] <= lengths[0]
    assert lengths[0] == Settings(iterations=iterations, rounds=rounds).round_steps


@given(iterations=st.integers(1, 300), rounds=st.integers(1, 9), data=st.data())
def test_each_step_has_its_number_in_its_round(iterations, rounds, data):
    after = restarts(iterations, rounds)
    assert [round_of(s, iterations, ()) for s in (1, iterations)] == [
        (1, iterations),
        (iterations,) * 2,
    ]
    turns = [round_of(step, iterations, after) for step in range(1, iterations + 1)]
    assert [step for step, (number, _) in enumerate(turns) if number == 1] == [0, *after]
    assert all(1 <= number <= length for number, length in turns)
    assert turns[-1][0] == turns[-1][1]
    told = data.draw(
        st.integers(max((0, *after)) + 1, 600)
    )  # another number of steps, told in the last round
    assert all(
        round_of(step, told, after)[0] == turns[step - 1][0]
        for step in range(1, min(told, iterations) + 1)
    )
    assert round_of(told, told, after) == (told - max((0, *after)),) * 2


def test_rates_begin_again_and_settle_in_each_round():
    trainer = trainer_of(GROWS)
    found = []
    for step in (1, 30, 31, 60):
        trainer.step = step
        found.append(trainer.rates())
    assert found[0] == found[2]
    assert found[1] == found[3]
    assert all(found[1][name] < 0.11 * found[0][name] for name in found[0])


def test_a_round_is_a_run_of_its_length_up_to_where_it_ends():
    """The first half of two rounds has the bits of a run of half as many steps."""
    trainer = trainer_of(GROWS)
    while trainer.step < 30:
        trainer.advance()
    alone = fit(tiny_scene(), replace(GROWS, iterations=30, rounds=1), RUN).bake()
    assert torch.equal(trainer.model.parameters.rows["means"].detach(), alone.means)


def test_a_second_round_grows_again_and_has_all_harmonics():
    trainer, counts = trainer_of(replace(GROWS, sh_interval=30_000)), []
    while trainer.step < trainer.plan.steps:
        trainer.advance()
        counts.append(len(trainer.model.parameters))
    assert counts[0] < counts[9] == counts[33] < counts[34] < counts[39] == counts[-1]
    assert isinstance(trainer.model, GaussianModel)
    moments = [Moment(step=s, total=60, generator=trainer.generator) for s in (1, 29, 30, 31, 60)]
    assert [trainer.model.drawn_degree(moment) for moment in moments] == [0, 0, 1, 1, 1]


def test_moments_are_forgotten_where_a_round_begins():
    trainer = trainer_of(GROWS)
    while trainer.step < 30:
        trainer.advance()
    assert trainer.optimizer.steps == 30
    trainer.advance()
    assert trainer.optimizer.steps == 1


def test_a_restarted_optimizer_moves_as_a_fresh_one():
    before, moves = torch.tensor([[1.0, 2.0, 3.0]]), []
    for used in (False, True):
        parameters = GaussianModel(random_gaussians(1), Rates(), extent=1.0).parameters
        optimizer = Adam(parameters)
        value = parameters.trained["means"]
        if used:
            value.grad = torch.tensor([[5.0, -1.0, 0.1]])
            optimizer.step({"means": 0.1})
            optimizer.restart()
        value.detach().copy_(before)
        value.grad = torch.tensor([[0.3, 0.0, -2.0]])
        optimizer.step({"means": 0.1})
        moves.append(value.detach() - before)
    assert torch.equal(*moves)
    assert moves[0].abs().max() > 0


@pytest.mark.parametrize("step", [pytest.param(20, marks=pytest.mark.slow), 30, 40])
def test_a_killed_run_goes_on_the_same_in_either_round(tmp_path, step):
    assert_continues(GROWS, RUN, step, tmp_path)


def test_steps_are_recounted_when_the_last_round_has_grown():
    settings = replace(GROWS, iterations=6000)
    assert Recount(settings, 60.0, 9000, print).first == 3000 + 1500 + 1
    assert Recount(replace(settings, rounds=1), 60.0, 9000, print).first == 3000 + 1


def test_relatives_of_3dgs_have_rounds():
    density = fsgs.FsgsDensity(start=0, interval=1)
    for made in (
        fsgs.prepare(tiny_scene(), fsgs.Fsgs(iterations=60, rounds=2, density=density), RUN),
        cor_gs.prepare(tiny_scene(), cor_gs.CorGS(iterations=60, rounds=2), RUN),
        stratosplat.prepare_from(
            tiny_scene(), StratoSplat(iterations=60, rounds=2, planes=Planes(field="table")), RUN
        ),
        mip_splatting.prepare(tiny_scene(), MipSettings(iterations=60, rounds=2), RUN),
    ):
        _, plan = made
        assert plan.restarts == (30,)
        assert isinstance(plan.density, DensityControl)
        settings = plan.density.settings
        assert settings.stop == round(type(settings)().stop / 1000)


def test_mip_splatting_adds_harmonics_in_each_round_as_in_a_run_of_its_length():
    made = (MipSettings(iterations=60, rounds=2), MipSettings(iterations=30))
    one, other = (
        mip_splatting.prepare(tiny_scene(), settings, RUN)[0].sh_every for settings in made
    )
    assert one == other > 0


def test_rounds_below_one_and_views_looked_at_in_rounds_are_refused():
    with pytest.raises(UsageError, match="setting rounds is 0"):
        Settings(rounds=0)
    with pytest.raises(
        UsageError, match="setting rounds is 2, expected 1 where density control looks"
    ):
        ThreeDGS(rounds=2, density=StrategicDensity(strategy="error"))
