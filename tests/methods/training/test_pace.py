"""Growth at an even pace: equal shares of the room that is left, to the largest pulls, and nothing to remember."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.baking import baked
from helpers.killed_run import assert_continues
from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.sparse_views.fsgs import Fsgs, FsgsControl, FsgsDensity
from splatproof.methods.sparse_views.fsgs import prepare as prepare_fsgs
from splatproof.methods.threedgs.density import ErrorGate, Insertion, Mcmc, StrategicDensity
from splatproof.methods.threedgs.error_control import ErrorControl
from splatproof.methods.threedgs.fit import fit, prepare
from splatproof.methods.threedgs.settings import Settings, ThreeDGS
from splatproof.methods.training.density import Density
from splatproof.methods.training.density_control import (
    DensityControl,
    densifications_left,
    most_after,
    shrunk,
)
from splatproof.methods.training.schedules import Rates
from splatproof.methods.training.session import train

RUN = Run(threads=1, seed=3)
OFTEN: dict[str, Any] = {
    "start": 0,
    "interval": 10,
    "least_interval": 10,
    "stop": 25_000,
    "reset_interval": 0,
}
"""Four densifications in 60 steps: at 10, 20, 30 and 40."""
EVEN = Density(**OFTEN, gradient=0.0, least_opacity=0.0, largest_size=1e6, most=100, pace="even")
SCHEDULES = st.builds(
    Density, start=st.integers(0, 9000), stop=st.integers(0, 16_000), interval=st.integers(1, 400),
    least_interval=st.integers(1, 200), fewest=st.integers(0, 5), most=st.integers(1, 5000), pace=st.just("even"),
)  # fmt: skip


def steps_of(settings: Density, iterations: int) -> list[int]:
    control = DensityControl(settings, iterations=iterations, extent=1.0)
    return [step for step in range(1, iterations + 1) if control.densifies(step)]


def rows(count: int = 40) -> Parameters:
    return GaussianModel(random_gaussians(count), Rates(), extent=1.0).parameters


def pulled(control: DensityControl, pulls: torch.Tensor) -> None:
    """Stands for views in which every row was seen and pulled at so much."""
    control.gradient_sum, control.seen = pulls.clone(), torch.ones_like(pulls)
    control.absolute_sum = pulls.clone()


def grown(
    settings: Density, count: int, *, iterations: int = 60, wanting: float = 1.0
) -> list[int]:
    """Number of rows after each densification where a share of the rows wants to grow, whatever pulls."""
    control = DensityControl(settings, iterations=iterations, extent=1.0)
    parameters = rows(count)
    numbers = [count]
    for step in steps_of(settings, iterations):
        pull = torch.full((len(parameters),), -1.0)
        pull[: round(wanting * len(pull))] = 1.0
        pulled(control, pull)
        for edit in control.edits(step, parameters, torch.Generator().manual_seed(step)):
            parameters.edit(edit)
        numbers.append(len(parameters))
    return numbers


@given(settings=SCHEDULES, iterations=st.integers(1, 3000))
def test_as_many_densifications_are_left_as_come(settings, iterations):
    own = shrunk(settings, iterations)
    coming = steps_of(settings, iterations)
    for step in {1, *coming, *(step + 1 for step in coming), iterations}:
        assert densifications_left(own, step) == sum(other >= step for other in coming)


@given(settings=SCHEDULES, iterations=st.integers(1, 3000), count=st.integers(1, 6000))
def test_where_all_want_to_grow_the_number_rises_by_as_many_each_time_and_ends_at_the_cap(
    settings, iterations, count
):
    own, coming = shrunk(settings, iterations), steps_of(settings, iterations)
    assert settings.most is not None
    numbers = [count]
    for step in coming:
        allowed = most_after(own, step, numbers[-1])
        assert allowed is not None
        numbers.append(max(numbers[-1], allowed))
    for k, number in enumerate(numbers):
        line = count + max(0, settings.most - count) * k / max(1, len(coming))
        # rounding down leaves less than a row to each later densification, and never goes above the line
        assert line - k <= number <= line + 1e-9 * settings.most
    if coming:
        assert numbers[-1] == max(count, settings.most)


@given(
    settings=SCHEDULES,
    iterations=st.integers(200, 3000),
    count=st.integers(1, 4000),
    data=st.data(),
)
def test_nothing_ever_leads_above_the_even_line_whoever_is_removed_meanwhile(
    settings, iterations, count, data
):
    own, coming = shrunk(settings, iterations), steps_of(settings, iterations)
    assert settings.most is not None
    now = count
    for k, step in enumerate(coming, 1):
        allowed = most_after(own, step, now)
        assert allowed is not None
        assert min(now, settings.most) <= allowed <= settings.most
        now = max(now, allowed) - data.draw(st.integers(0, max(0, now - 1)))
        assert now <= count + max(0, settings.most - count) * k / len(coming) + 1e-9 * settings.most


def test_a_free_pace_is_bounded_by_the_cap_alone():
    assert most_after(Density(most=100), 600, 40) == 100
    assert most_after(Density(), 600, 40) is None
    assert most_after(Density(most=100, pace="even"), 600, 140) == 100, (
        "never less than was asked for"
    )


def test_a_run_grows_evenly_and_a_free_one_at_once():
    assert grown(EVEN, 40) == [40, 55, 70, 85, 100]
    assert grown(replace(EVEN, pace="free"), 40) == [40, 80, 100, 100, 100]


def test_room_that_was_not_wanted_is_shared_by_those_who_come_later():
    first, *rest = grown(replace(EVEN, most=120), 40, wanting=0.2)
    assert (first, rest[0]) == (40, 48), "a fifth of 40 wants to grow, 20 may"
    assert rest[-1] <= 120
    full = grown(replace(EVEN, most=43), 40, wanting=0.5)
    assert full == [40, 40, 41, 42, 43]


@given(most=st.integers(1, 140), seed=st.integers(0, 99))
def test_the_largest_pulls_go_first(most, seed):
    control = DensityControl(replace(EVEN, gradient=0.5, most=most), iterations=60, extent=1.0)
    pulls = torch.rand(40, generator=torch.Generator().manual_seed(seed))
    pulled(control, pulls)
    (edit,) = control.edits(10, rows(), torch.Generator().manual_seed(0))
    assert edit.parents is not None
    times = edit.parents.bincount(minlength=40)
    assert times.sum() <= 40 + max(0, most - 40) // 4
    wanting = pulls >= 0.5
    assert (times > 1).sum() == min(int(wanting.sum()), max(0, most - 40) // 4)
    if (times > 1).any():
        waiting = pulls[wanting & (times == 1)]
        assert (pulls[times > 1].min() >= waiting).all()


LOOSE = replace(EVEN, gradient=1e-5, most=10_000)
TIGHT = replace(LOOSE, most=60)
SHORT = Settings(iterations=60, sh_degree=1, density=TIGHT)


def test_under_a_cap_that_nothing_comes_near_it_is_the_free_pace():
    even, free = (
        baked(fit(tiny_scene(), replace(SHORT, density=density), RUN))
        for density in (LOOSE, replace(LOOSE, pace="free", most=None))
    )
    assert torch.equal(even.means, free.means)
    assert torch.equal(even.sh, free.sh)


def test_the_same_seed_gives_the_same_model_and_the_pace_another_one():
    one, again = (baked(fit(tiny_scene(), SHORT, RUN)) for _ in range(2))
    assert torch.equal(one.means, again.means)
    assert 40 < len(one.means) <= 60
    free = baked(fit(tiny_scene(), replace(SHORT, density=replace(TIGHT, pace="free")), RUN))
    assert one.means.shape != free.means.shape or not torch.equal(one.means, free.means)


@pytest.mark.parametrize("at", [20, *(pytest.param(n, marks=pytest.mark.slow) for n in (10, 30))])
def test_a_killed_run_continues_bit_for_bit(at, tmp_path):
    chosen = ThreeDGS(iterations=60, sh_degree=1, density=StrategicDensity(**vars(TIGHT)))
    assert_continues(chosen, RUN, at, tmp_path)


def test_a_training_that_learns_on_the_way_how_long_it_is_keeps_the_pace():
    """The schedule is that of the steps that were planned; more of them later change nothing of it."""

    def numbers(recount) -> list[float]:
        told = []

        def prepared():
            model, plan = prepare(tiny_scene(), SHORT, RUN)
            return model, replace(plan, recount=recount(told, model))

        train(RUN, prepared)
        return told

    def counting(told, model, steps):
        def recount(step, seconds):
            told.append(model.primitives)
            return steps if step == 15 else None

        return recount

    straight = numbers(lambda told, model: counting(told, model, None))
    longer = numbers(lambda told, model: counting(told, model, 90))
    assert (len(straight), len(longer)) == (60, 90)
    for one, other in zip(straight[:15], longer[:15], strict=True):
        assert one == other
    for told in (straight, longer):
        line = [40 + 20 * min(4, step // 10) / 4 for step in range(1, 1 + len(told))]
        assert all(number <= most for number, most in zip(told, line, strict=True))


@pytest.mark.parametrize(("gated", "share", "least"), [(False, 1.0, 50), (True, 0.1, 44)])
def test_insertion_and_densification_share_what_a_step_may_add(gated, share, least):
    density = StrategicDensity(
        **OFTEN, gradient=0.0, least_opacity=0.0, largest_size=1e6, most=80, pace="even", scored_views=3,
        strategy="error" if gated else "gradient", insertion=Insertion(share=share),
        error=ErrorGate(pixels=0.0) if gated else ErrorGate(),
    )  # fmt: skip
    model, plan = prepare(tiny_scene(), ThreeDGS(iterations=60, sh_degree=1, density=density), RUN)
    control, parameters = plan.density, model.parameters
    assert isinstance(control, ErrorControl)
    pulled(control, torch.ones(40))
    for edit in control.edits(10, parameters, torch.Generator().manual_seed(0)):
        parameters.edit(edit)
    assert least <= len(parameters) <= 50


def test_what_is_unpooled_keeps_to_the_pace():
    density = FsgsDensity(**vars(replace(EVEN, most=80, gradient=1e3)), unpool_distance=0.0)
    model, plan = prepare_fsgs(
        tiny_scene(), Fsgs(iterations=60, sh_degree=1, density=density), RUN
    )  # fmt: skip
    control, parameters = plan.density, model.parameters
    assert isinstance(control, FsgsControl)
    pulled(control, torch.zeros(40))
    for edit in control.edits(10, parameters, torch.Generator().manual_seed(0)):
        parameters.edit(edit)
    assert 40 < len(parameters) <= 50


def test_without_room_to_share_out_or_who_clones_it_is_refused():
    with pytest.raises(
        UsageError, match="density.pace is 'even', expected free where density.most"
    ):
        Density(pace="even")
    mcmc = StrategicDensity(strategy="mcmc", most=60, mcmc=Mcmc(), pace="even")
    with pytest.raises(UsageError, match="density.pace is 'even', expected free, its default"):
        ThreeDGS(density=mcmc)
