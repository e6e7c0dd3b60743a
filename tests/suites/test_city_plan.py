"""Plans of cities: against loops, bounds and what must not get worse."""

import itertools
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.base.errors import UsageError
from splatproof.methods.threedgs.cost import GAUSSIAN_STEP, PIXEL_STEP
from splatproof.metrics.balance import makespan
from splatproof.suites.city_plan import (
    City,
    block_cpu_seconds,
    block_gaussians,
    block_memory,
    fewest_blocks,
    most_useful_blocks,
    most_useful_machines,
    plan,
    simulate,
)

CITY = City()
TIMES = st.lists(st.floats(0.1, 9), min_size=1, max_size=6)


@settings(deadline=None, max_examples=50)
@given(times=TIMES, workers=st.integers(1, 4))
def test_handing_out_longest_first_is_near_the_best(times, workers):
    found = makespan(sorted(times, reverse=True), workers)
    best = min(
        max(sum(t for t, w in zip(times, who, strict=True) if w == one) for one in range(workers))
        for who in itertools.product(range(workers), repeat=len(times))
    )
    # Graham 1969: within 4/3 - 1/(3 m) of the best
    assert best - 1e-9 <= found <= best * (4 / 3 - 1 / (3 * workers)) + 1e-9


def test_by_hand():
    assert makespan([5.0, 4.0, 3.0, 3.0, 3.0], 2) == 10  # 5 + 3, 4 + 3 + 3
    assert makespan([2.0], 9) == 2.0


def test_a_block_is_its_share_of_the_work():
    city = replace(CITY, margin=0.0, gaussians=1_000_000, iterations=1000, pixels=100)
    assert block_gaussians(city, 10) == 100_000
    step = 100 * PIXEL_STEP + 50_000 * GAUSSIAN_STEP
    assert block_cpu_seconds(city, 10) == pytest.approx(3 + 1000 * step)
    assert block_gaussians(replace(city, margin=0.5), 1) == 1_000_000  # one block has no rim
    assert block_gaussians(replace(city, margin=0.5), 10) == pytest.approx(225_000)


@settings(deadline=None, max_examples=50)
@given(blocks=st.integers(1, 500), machines=st.integers(1, 64), gaussians=st.integers(10**5, 10**9))
def test_plans_fit_and_more_machines_or_memory_never_cost_time(blocks, machines, gaussians):
    city = replace(CITY, gaussians=gaussians)
    found = plan(city, blocks, machines)
    assert found.workers * found.block_memory_mb <= city.memory_gb * 1024
    assert 0 <= found.workers <= city.cores
    more = plan(city, blocks, 2 * machines)
    # a machine that trains fewer blocks at a time gives each more cores
    assert more.seconds <= found.seconds * 1.001
    roomy = plan(replace(city, memory_gb=4 * city.memory_gb), blocks, machines)
    # more workers at a time share the cores: the last wave may be emptier, but not by a whole one
    assert roomy.blocks_seconds <= 2 * found.blocks_seconds


@settings(deadline=None, max_examples=30)
@given(gaussians=st.integers(10**6, 10**9), memory=st.sampled_from([4.0, 16.0, 64.0]))
def test_the_fewest_blocks_fit_and_one_fewer_does_not(gaussians, memory):
    city = replace(CITY, gaussians=gaussians, memory_gb=memory)
    fewest = fewest_blocks(city)
    assert block_memory(city, fewest) <= memory * 1024
    assert fewest == 1 or block_memory(city, fewest - 1) > memory * 1024
    assert plan(city, fewest, 1).workers >= 1
    if fewest > 1:
        none = plan(city, fewest - 1, 1)
        assert none.workers == 0
        assert none.seconds == float("inf")


def test_where_it_stops_scaling():
    useful = most_useful_blocks(CITY)
    pixels = CITY.pixels * PIXEL_STEP
    for blocks, many in ((useful * 2, True), (useful // 2, False)):
        rest = block_gaussians(CITY, blocks) / 2 * GAUSSIAN_STEP
        assert (pixels > rest) is many
    stop = most_useful_machines(CITY, 64)
    assert plan(CITY, 64, stop).blocks_seconds <= 2.1 * plan(CITY, 64, stop).serial_seconds
    quick = replace(CITY, refinement=0)
    assert most_useful_machines(quick, 64) > stop  # refining is what one machine does alone
    assert plan(quick, 64, 1).refine_memory_mb == 0


def test_equal_times_simulate_to_the_plan_and_spread_costs_time():
    found = plan(CITY, 64, 8)
    level = simulate(found, 0.0, 0)
    assert level.mean == level.fastest == level.slowest == pytest.approx(found.blocks_seconds)
    one_wave = plan(CITY, 8, 8)
    uneven = simulate(one_wave, 0.4, 0)
    assert uneven.mean > one_wave.blocks_seconds
    assert uneven.busy < 1
    assert uneven == simulate(one_wave, 0.4, 0)
    assert uneven != simulate(one_wave, 0.4, 1)


@pytest.mark.parametrize(
    "wrong",
    [{"views": 0}, {"gaussians": -1}, {"margin": -0.1}, {"refinement": -1}, {"memory_gb": 0.0}],
)
def test_what_is_no_city_is_refused(wrong):
    with pytest.raises(UsageError, match="expected"):
        City(**wrong)
    with pytest.raises(UsageError, match="--(blocks|machines) is 0, expected from 1"):
        plan(CITY, 0, 1)
    with pytest.raises(UsageError, match="--spread is -1.0, expected from 0 to 10"):
        simulate(plan(CITY, 64, 1), -1.0, 0)
    with pytest.raises(UsageError, match="use larger machines or smaller views"):
        fewest_blocks(replace(CITY, memory_gb=0.1))
