"""Rates and density control that begin again: rounds of one length, each as a run of that length."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.killed_run import assert_continues
from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.auto.recount import Recount
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.sparse_views.cor_gs import CoControl, CorGS
from splatproof.methods.sparse_views.density import SparseControl, SparseDensity
from splatproof.methods.sparse_views.twin_fields import FIELD, twice
from splatproof.methods.threedgs.density import Mcmc, StrategicDensity
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.mcmc import McmcControl
from splatproof.methods.threedgs.settings import Settings, ThreeDGS
from splatproof.methods.training.density import Density
from splatproof.methods.training.density_control import DensityControl, grown_at, shrunk
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.schedules import (
    Rates,
    in_rounds,
    log_linear,
    round_steps,
    settling,
    since,
)

RUN = Run(threads=1, seed=3)
SCHEDULES = st.builds(
    Density, start=st.integers(0, 7000), stop=st.integers(0, 9000), interval=st.integers(1, 400),
    least_interval=st.integers(1, 100), fewest=st.integers(0, 5), reset_interval=st.integers(0, 4000),
    again=st.integers(9000, 20_000),
)  # fmt: skip
GROWS = Settings(
    iterations=60, sh_degree=1,
    density=Density(start=0, interval=1, least_interval=5, stop=7500, reset_interval=0, again=15_000,
    gradient=0.0, least_opacity=0.0),
    rates=Rates(again=15_000, settle=0.1),
)  # fmt: skip


@given(rounds=st.sampled_from([1, 2, 3, 4, 5, 6, 10]), iterations=st.integers(10, 30_000))
def test_a_run_does_not_end_with_the_first_steps_of_another_round(rounds, iterations):
    steps = round_steps(30_000 // rounds, iterations)
    assert steps * rounds >= iterations
    assert since(iterations, steps) > steps - rounds


@given(step=st.integers(1, 10_000), again=st.integers(1, 3000), rounds=st.integers(0, 3))
def test_a_step_is_that_of_each_round(step, again, rounds):
    assert since(step, 0) == step
    assert 1 <= since(step, again) <= again
    assert since(step + rounds * again, again) == since(step, again)
    assert step > again or since(step, again) == step


@given(again=st.integers(1000, 30_000), iterations=st.integers(1, 30_000), share=st.floats(0, 1))
def test_each_round_has_the_rates_of_a_run_of_its_length(again, iterations, share):
    steps = round_steps(again, iterations)
    step = max(1, round(share * iterations))
    for rate in (log_linear(1e-2, 1e-4, factor=3.0), settling(0.05, 0.1)):
        assert in_rounds(rate, 0) is rate
        assert in_rounds(rate, again)(step, iterations) == rate(since(step, steps), steps)


def test_rates_rise_where_a_round_begins_and_end_low():
    rate = in_rounds(settling(1.0, 0.1), 15_000)
    assert [round(rate(step, 60), 2) for step in (1, 15, 30, 31, 45, 60)] == [1, 1, 0.1, 1, 1, 0.1]
    odd = in_rounds(settling(1.0, 0.1), 15_000)  # 61 steps: a round of 31 and one of 30
    assert odd(61, 61) < 0.13 < odd(32, 61)


def test_every_rate_of_a_model_begins_again_and_what_is_held_stays_held():
    model = GaussianModel(
        random_gaussians(3), Rates(again=15_000, settle=0.1, quaternions=0.0), extent=2.0
    )
    assert "quaternions" not in model.schedules
    for name, rate in model.schedules.items():
        assert rate(31, 60) == pytest.approx(rate(1, 60)), name
        assert rate(30, 60) < rate(31, 60), name


@given(settings=SCHEDULES, iterations=st.integers(100, 400))
def test_densifications_and_resets_come_at_the_same_steps_of_every_round(settings, iterations):
    control = DensityControl(settings, iterations=iterations, extent=1.0)
    steps, again = range(1, iterations + 1), control.settings.again
    assert again == round_steps(settings.again, iterations)
    for happens in (control.densifies, control.resets, control.watches):
        assert all(happens(step) == happens(since(step, again)) for step in steps)
    last = grown_at(control.settings, iterations)
    assert not any(
        control.densifies(step) or control.resets(step) for step in steps if step >= last
    )
    alone = DensityControl(replace(settings, again=0), iterations=iterations, extent=1.0)
    early = range(1, min(again, iterations) + 1)
    assert [*map(control.densifies, early)] == [*map(alone.densifies, early)]


def test_a_run_without_rounds_is_grown_when_density_control_stops():
    assert grown_at(shrunk(Density(), 3000), 3000) == 1500
    assert grown_at(shrunk(Density(stop=7500, again=15_000), 3000), 3000) == 2250


def test_relatives_of_density_control_begin_again_too():
    sparse = SparseDensity(stop=7500, again=15_000, reset_interval=2500, first_reset=1250)
    control = SparseControl(sparse, iterations=60, extent=1.0)
    resets = [step for step in range(1, 61) if control.resets(step)]
    assert resets == [2, 7, 12, 32, 37, 42]
    moving = StrategicDensity(
        strategy="mcmc", mcmc=Mcmc(), most=50, stop=7500, again=15_000, reset_interval=0
    )
    model, plan = prepare(
        tiny_scene(), ThreeDGS(iterations=60, density=moving, rates=Rates(again=15_000)), RUN
    )
    del model
    assert isinstance(plan.density, McmcControl)
    assert plan.density.rate(31, 60) == plan.density.rate(1, 60) > plan.density.rate(30, 60)


def test_a_second_round_grows_again():
    model, plan = prepare(tiny_scene(), GROWS, RUN)
    trainer, counts = Trainer(model, plan, RUN), []
    while trainer.step < plan.steps:
        trainer.advance()
        counts.append(len(model.parameters))
    first, between, second = counts[14], counts[29], counts[-1]
    assert counts[0] < first == between < second


def test_a_run_killed_in_its_second_round_goes_on_the_same(tmp_path):
    assert_continues(GROWS, RUN, 40, tmp_path)


def test_steps_are_recounted_when_the_last_round_has_grown():
    told = []
    settings = replace(
        GROWS, iterations=6000, density=replace(GROWS.density, start=0, interval=100)
    )
    assert Recount(settings, 60.0, 9000, told.append).first == 4501
    once = replace(settings, density=replace(settings.density, again=0))
    assert Recount(once, 60.0, 9000, told.append).first == 1501


@pytest.mark.parametrize(
    "settings", [{"again": -1}, {"again": 15_000, "most": 100, "pace": "even"}]
)
def test_what_cannot_begin_again_is_refused(settings):
    with pytest.raises(UsageError, match=r"density\.(again|pace) is"):
        Density(**settings)


def test_rates_that_begin_again_before_they_began_are_refused():
    with pytest.raises(UsageError, match=r"rates\.again is -1"):
        Rates(again=-1)


def test_co_pruning_begins_again():
    density = SparseDensity(start=0, stop=7500, again=15_000, interval=30_000, reset_interval=0)
    settings = CorGS(iterations=600, density=density, prune_interval=2500)
    control = CoControl(settings, extent=1.0)
    start, fields = twice(random_gaussians(20))
    parameters = GaussianModel(start, Rates(), extent=1.0, labels={FIELD: fields}).parameters
    generator = torch.Generator().manual_seed(0)
    steps = range(1, 601)
    pruned = [step for step in steps if [*control.edits(step, parameters, generator)]]
    assert pruned == [100, 400]
