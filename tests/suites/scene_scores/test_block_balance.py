from dataclasses import replace

import pytest

from splatproof.methods.city.block_facts import BlockFacts
from splatproof.metrics.scene_registry import BLOCKS, SCENE_METRICS
from splatproof.suites.scene_scores.block_balance import (
    FIELDS,
    balance_metrics,
    fewest_densifications,
    four_machine_seconds,
    over_hard_cut,
    retention,
)


def test_by_hand():
    block = BlockFacts(block=0, views=3, points=10, load=30, primitives=5)
    blocks = [
        replace(block, seconds=1.0, cpu_seconds=2.0, peak_mb=100.0),
        replace(block, points=30, seconds=3.0, cpu_seconds=4.0, peak_mb=300.0),
    ]
    found = balance_metrics(blocks)
    assert found["seconds_max_over_mean"] == pytest.approx(1.5)
    assert found["cpu_max_over_mean"] == pytest.approx(4 / 3)
    assert found["memory_std_over_mean"] == pytest.approx(0.5)
    assert found["load_std_over_mean"] == found["views_std_over_mean"] == 0
    assert found["load_max_over_mean"] == found["primitives_max_over_mean"] == 1
    assert found.keys() <= SCENE_METRICS.keys()
    assert len(found) == 2 * len(FIELDS)
    assert set(FIELDS) == set(BLOCKS)


def test_what_was_not_measured_is_left_out():
    found = balance_metrics([BlockFacts(block=0, views=1, points=2, load=3)])
    assert "seconds_max_over_mean" not in found
    assert found["points_max_over_mean"] == 1


def test_the_block_that_was_densified_least_is_told_and_empty_or_unknown_ones_do_not_count():
    block = BlockFacts(block=0, views=1, points=2, load=3, primitives=5, densifications=4)
    others = [replace(block, densifications=2), replace(block, primitives=0, densifications=0)]
    assert fewest_densifications([block, *others]) == {"block_densifications": 2.0}
    assert fewest_densifications([replace(block, densifications=-1)]) == {}
    assert "block_densifications" in SCENE_METRICS


def test_retention_is_the_share_of_trained_gaussians_that_are_left():
    block = BlockFacts(block=0, views=1, points=2, load=3, primitives=100, kept=80)
    others = [replace(block, primitives=300, kept=20), replace(block, primitives=0, kept=0)]
    assert retention([block, *others]) == {"retention": 0.25}
    assert retention([replace(block, primitives=0, kept=0)]) == {}
    assert "retention" in SCENE_METRICS


def test_four_machines_take_the_longest_block_and_all_that_one_machine_does():
    block = BlockFacts(block=0, views=1, points=2, load=3, seconds=10.0, primitives=5)
    stages = {"coarse": 5.0, "blocks": 99.0, "refine": 2.0}
    assert four_machine_seconds(stages, {}, [block, replace(block, seconds=4.0)], {}) == {
        "four_machine_seconds": 17.0
    }
    # of six blocks two machines have two each: 10, 10, 10, 4 + 3 and no more than that
    six = [replace(block, seconds=s) for s in (3.0, 10.0, 4.0, 10.0, 10.0, 1.0)]
    assert four_machine_seconds(stages, {}, six, {}) == {"four_machine_seconds": 17.0}
    assert four_machine_seconds(stages, {}, [block, replace(block, seconds=0.0)], {}) == {}
    assert four_machine_seconds({"coarse": 5.0}, {}, [block], {}) == {}
    assert four_machine_seconds(stages, stages, [], {}) == {}
    # a block that was left empty takes nothing, and is no reason to know nothing
    empty = replace(block, seconds=0.0, primitives=0)
    assert four_machine_seconds(stages, {}, [*six, empty], {}) == {"four_machine_seconds": 17.0}
    assert {"four_machine_seconds", "four_machine_cpu_seconds"} <= set(SCENE_METRICS)


def test_four_machines_share_the_parts_of_a_refinement_and_processor_seconds_are_added_alike():
    block = BlockFacts(block=0, views=1, points=2, load=3, seconds=10.0, cpu_seconds=9.0, primitives=5,
                       refine_seconds=3.0, refine_cpu_seconds=2.0)  # fmt: skip
    blocks = [block, replace(block, seconds=4.0, cpu_seconds=4.0, refine_seconds=1.0)]
    stages = {"coarse": 5.0, "blocks": 14.0, "refine": 4.0}
    cpu = {"coarse": 4.0, "blocks": 0.5, "refine": 0.5}
    alone = {
        "seconds": 0.5,
        "cpu_seconds": 0.25,
    }  # cleaning, levels, what is handed out and put together
    assert four_machine_seconds(stages, cpu, blocks, alone) == {
        "four_machine_seconds": 5.0 + 10.0 + 3.0 + 0.5, "four_machine_cpu_seconds": 4.0 + 9.0 + 2.0 + 0.25,
    }  # fmt: skip
    assert four_machine_seconds(stages, cpu, blocks, {}) == {}  # a file from before it was kept
    whole = [replace(b, refine_seconds=0.0, refine_cpu_seconds=0.0) for b in blocks]
    assert four_machine_seconds(stages, cpu | {"refine": 3.5}, whole, {}) == {
        "four_machine_seconds": 5.0 + 10.0 + 4.0, "four_machine_cpu_seconds": 4.0 + 9.0 + 3.5,
    }  # fmt: skip


def test_what_a_merge_adds_is_over_what_a_hard_cut_keeps():
    block = BlockFacts(block=0, views=1, points=2, load=3, primitives=100, kept=60, core=50)
    other = replace(block, kept=40, core=40)
    assert over_hard_cut([block, other]) == {"over_hard_cut": pytest.approx(100 / 90)}
    assert over_hard_cut([block]) == {}  # there is no cut
    assert over_hard_cut([block, replace(other, core=-1)]) == {}
    assert over_hard_cut([replace(block, core=0), replace(other, core=0)]) == {}
    assert "over_hard_cut" in SCENE_METRICS
