"""The rules that bind a leaderboard, each with a case that breaks it."""

import dataclasses
import io
import math
import re
from collections.abc import Sequence
from typing import Any

import pytest
from rich.console import Console

from helpers.case_folders import NAMES, result
from splatproof.base.errors import DataError
from splatproof.metrics.registry import BUILT_IN
from splatproof.metrics.scene_registry import SCENE_METRICS
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore, Result
from splatproof.reports import text
from splatproof.reports.comparable import OF_PLACES
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.table import Row, Table
from splatproof.suites.environment import environment


def seeds(count: int = 3, **named: Any) -> list[Result]:
    return [result(seed=seed, **named) for seed in range(count)]


def of(results: Sequence[Result], **changes: Any) -> list[Result]:
    return [dataclasses.replace(one, **changes) for one in results]


def only_table(results: Sequence[Result]) -> Table:
    (table,) = build_tables(results)
    return table


def rows(table: Table) -> dict[str, Row]:
    return {row.label: row for row in table.rows}


CLEAR = [*seeds(psnr=24.0), *seeds(method="better", psnr=25.0), *seeds(method="worst", psnr=20.0)]


def test_rows_are_ranked_by_the_first_metric():
    table = only_table(CLEAR)
    assert [(row.label, row.rank) for row in table.rows] == [
        ("better", 1),
        ("3dgs", 2),
        ("worst", 3),
    ]
    cell = rows(table)["3dgs"].cells["psnr"]
    values = [one.metrics["psnr"] for one in CLEAR[:3]]
    assert cell.mean == pytest.approx(sum(values) / 3)
    assert cell.low < cell.mean < cell.high
    assert [row.label for row in table.rows if "psnr" in row.best] == ["better"]


def rescored(one: Result, name: str, value: float) -> Result:
    scores = tuple(dataclasses.replace(image, metrics={name: value}) for image in one.images)
    return dataclasses.replace(one, images=scores, metrics={name: value})


def test_where_lower_is_better_the_order_turns():
    rules = Protocol(name="flipped", source="ours", metrics=("flip",))
    results = [
        rescored(one, "flip", value + 1e-3 * one.seed)
        for method, value in {"a": 0.3, "b": 0.1}.items()
        for one in seeds(method=method, protocol=rules)
    ]
    unscored = [
        dataclasses.replace(rescored(one, "flip", math.nan), metrics={})
        for one in seeds(method="none", protocol=rules)
    ]
    table = only_table([*results, *unscored])
    assert [(row.label, row.rank) for row in table.rows] == [("b", 1), ("a", 2), ("none", None)]
    assert "flip" in rows(table)["b"].best
    assert table.columns[0].heading == "flip ↓"


def test_rows_that_cannot_be_told_apart_share_a_rank():
    close = [*seeds(psnr=24.0, spread=0.3), *seeds(method="other", psnr=24.02, spread=0.3)]
    table = only_table([*close, *seeds(method="worst", psnr=20.0)])
    assert [row.rank for row in table.rows] == [1, 1, 3]
    assert all("psnr" in row.best for row in table.rows[:2])
    assert any(d.verdict == "no difference" for _, _, d in table.differences)


@pytest.mark.parametrize("count", [1, 2])
def test_fewer_than_three_seeds_are_shown_and_not_ranked(count: int):
    table = only_table([*seeds(), *seeds(count, method="hasty", psnr=30.0)])
    hasty = rows(table)["hasty"]
    assert hasty.rank is None
    assert hasty.note.startswith(f"unranked: {count} seed")
    assert hasty.cells["psnr"].mean > 29
    assert rows(table)["3dgs"].rank == 1
    assert not hasty.best
    assert table.rows[-1] is hasty  # behind every ranked row


def test_oracle_appearance_is_never_ranked():
    rules = Protocol(name="oracle", source="ours", appearance="oracle", metrics=("psnr",))
    table = only_table([*seeds(protocol=rules), *seeds(protocol=rules, method="b")])
    assert {row.note for row in table.rows} == {"unranked: oracle appearance"}
    assert {row.rank for row in table.rows} == {None}


def test_two_protocols_never_meet():
    other = Protocol(name="other", source="ours", metrics=("psnr",))
    tables = build_tables([*seeds(), *seeds(protocol=other, method="b")])
    assert [(table.protocol, [row.label for row in table.rows]) for table in tables] == [
        ("other", ["b"]),
        ("ours_250", ["3dgs"]),
    ]


def test_one_name_with_two_sets_of_rules_is_two_protocols():
    one = Protocol(name="same", source="ours", metrics=("psnr",))
    two = dataclasses.replace(one, rounding="truncate")
    tables = build_tables([*seeds(protocol=one), *seeds(protocol=two, method="b")])
    assert [len(table.rows) for table in tables] == [1, 1]
    assert all("other rules" in table.warnings[0] for table in tables)


def with_image(one: Result, **changes: Any) -> Result:
    changed = dataclasses.replace(one.images[0], **changes)
    return dataclasses.replace(one, images=(changed, *one.images[1:]))


def with_facts(one: Result, photos: str) -> Result:
    """Of other photos, and of another release of a library, which is no fault."""
    facts = {"photos_sha256": photos, "torch": photos}
    return dataclasses.replace(one, scene_facts=one.scene_facts | facts)


def test_facts_that_only_some_results_have_are_no_fault():
    assert only_table([with_facts(CLEAR[0], "0"), *CLEAR[1:]]).comparable


@pytest.mark.parametrize(
    ("break_it", "said"),
    [
        (lambda one: with_image(one, truth_sha256="0"), "truth pixels differ in 1 images, e.g. dji_0001"),
        (lambda one: with_image(one, name="x.jpg"), "test images differ"),
        (lambda one: dataclasses.replace(one, split_sha256="0"), "the training images differ"),
        (lambda one: with_facts(one, "1"), "the scene's files differ (photos_sha256)"),
    ],
)  # fmt: skip
def test_other_truth_is_said_and_nothing_is_ranked(break_it, said: str):
    broken = [with_facts(CLEAR[0], "0"), *CLEAR[1:-1], break_it(CLEAR[-1])]
    table = only_table(broken)
    assert not table.comparable
    assert any(said in warning for warning in table.warnings)
    assert {row.rank for row in table.rows} == {None}
    assert {row.note for row in table.rows} == {"unranked: not comparable"}
    assert not table.differences
    assert only_table(CLEAR).comparable  # the control


def test_the_mean_is_given_only_where_every_declared_scene_is_there():
    declared = ("beach", "town")
    both = [*seeds(scene="town"), *seeds(scene="beach", psnr=20.0)]
    partial = seeds(scene="town", method="partial")
    mean, beach, town = build_tables(of([*both, *partial], suite_scenes=declared))
    assert (mean.scene, beach.scene, town.scene) == ("", "beach", "town")
    whole, lacking = rows(mean)["3dgs"], rows(mean)["partial"]
    assert whole.cells["psnr"].mean == pytest.approx(
        sum(one.metrics["psnr"] for one in both) / len(both)
    )
    assert whole.rank == 1
    assert lacking.note == "no mean: lacks beach"
    assert not lacking.cells
    assert lacking.rank is None
    assert rows(town)["partial"].rank is not None


def test_a_table_of_means_that_no_row_has_yet_is_not_the_first():
    tables = build_tables(of(seeds(), suite_scenes=("beach", "town")))
    assert [table.scene for table in tables] == ["town", ""]


def test_a_suite_of_one_scene_or_of_undeclared_scenes_has_no_mean():
    assert [t.scene for t in build_tables(of(seeds(), suite_scenes=("town",)))] == ["town"]
    assert [t.scene for t in build_tables([*seeds(), *seeds(scene="b")])] == ["b", "town"]


def test_the_mean_takes_the_seeds_that_every_scene_has():
    some = [*seeds(4, scene="town"), *seeds(3, scene="beach")]
    mean = build_tables(of(some, suite_scenes=("beach", "town")))[0]
    assert mean.rows[0].seeds == 3
    apart = [*seeds(1, scene="town"), result(scene="beach", seed=5)]
    mean = build_tables(of(apart, suite_scenes=("beach", "town")))[-1]
    assert mean.rows[0].note == "no mean: its scenes share no seed"


def test_a_scene_whose_truth_differs_bars_the_mean_from_ranking():
    both = [*seeds(scene="town"), *seeds(scene="beach")]
    both += [*seeds(scene="town", method="b"), *seeds(scene="beach", method="b")]
    both[0] = with_image(both[0], truth_sha256="0")
    mean = build_tables(of(both, suite_scenes=("beach", "town")))[0]
    assert {row.rank for row in mean.rows} == {None}
    assert "not comparable" in mean.rows[0].note


def test_settings_set_rows_apart_and_are_never_pooled():
    long = of(seeds(psnr=26.0), settings={"iterations": 7000, "sh_degree": 3})
    short = of(seeds(psnr=24.0), settings={"iterations": 2000, "sh_degree": 3})
    table = only_table([*long, *short])
    assert [row.label for row in table.rows] == ["3dgs (iterations=7000)", "3dgs (iterations=2000)"]


def test_settings_by_scene_are_one_row_with_a_warning_on_the_mean():
    town = of(seeds(scene="town"), settings={"iterations": 1})
    beach = of(seeds(scene="beach"), settings={"iterations": 2})
    mean = build_tables(of([*town, *beach], suite_scenes=("beach", "town")))[0]
    assert [row.label for row in mean.rows] == ["3dgs"]
    assert any("settings differ" in warning for warning in mean.warnings)


def test_times_of_two_machines_are_not_compared():
    slow = of(seeds(method="b", psnr=20.0), stages={"train": 400.0})
    assert "train_seconds" in rows(only_table([*seeds(), *slow]))["3dgs"].best
    moved = of(slow, environment={"cpu": "other"})
    table = only_table([*seeds(), *moved])
    assert any("different environments" in warning for warning in table.warnings)
    assert "train_seconds" not in rows(table)["3dgs"].best
    assert "psnr" in rows(table)["3dgs"].best


def test_a_path_of_gradients_that_the_method_decides_is_no_other_machine():
    ours = of(seeds(), environment={"gradients by": "kernels"})
    other = of(seeds(method="b", psnr=20.0), environment={"gradients by": "autograd"})
    assert not only_table([*ours, *other]).warnings
    mixed = [*ours[:2], *of(ours[2:], environment={"gradients by": "autograd"})]
    assert any("gradients by" in warning for warning in only_table([*mixed, *other]).warnings)


def test_a_path_of_gradients_that_a_plan_takes_in_one_seed_is_no_other_machine():
    """Method auto takes the slower one where its probe asks for exposures."""
    kernels, autograd = (
        {"gradients by": path, "plan: exposure": "one"} for path in ("kernels", "autograd")
    )
    planned = [*of(seeds()[:2], environment=kernels), *of(seeds()[2:], environment=autograd)]
    other = of(seeds(method="b", psnr=20.0), environment={"gradients by": "autograd"})
    assert not only_table([*planned, *other]).warnings


def test_what_methods_tell_of_their_work_is_no_other_machine():
    """A plan's facts differ from seed to seed."""
    planned = [
        only
        for seed, one in enumerate(seeds(method="auto", psnr=26.0))
        for only in of([one], environment=one.environment | {"plan: steps": str(seed)})
    ]
    table = only_table([*seeds(), *planned])
    assert not table.warnings
    assert "train_seconds" in {name for row in table.rows for name in row.best}


def test_other_weights_of_a_metric_are_told():
    other = [
        only
        for one in seeds(method="b")
        for only in of([one], environment=one.environment | {"weights of lpips": "0" * 64})
    ]
    assert any("weights of lpips" in warning for warning in only_table([*seeds(), *other]).warnings)


def test_whatever_says_where_a_result_was_made_is_compared():
    assert set(environment("cpu")) <= set(OF_PLACES)


def test_variants_say_in_which_settings_they_differ():
    whole = of(seeds(psnr=26.0), settings={"iterations": 800, "inner": {"rate": 1, "cap": 2}})
    half = of(seeds(), variant="half", settings={"iterations": 400, "inner": {"rate": 1, "cap": 3}})
    other = of(seeds(method="b"), settings={"iterations": 5})
    table = only_table([*whole, *half, *other])
    assert text.variants(table) == [
        "3dgs: iterations 800, inner.cap 2", "3dgs@half: iterations 400, inner.cap 3",
    ]  # fmt: skip
    assert set(text.variants(table)) <= set(text.notes(table))
    assert text.variants(only_table([*whole, *other])) == []
    unnamed = [*whole, *of(seeds(), settings={"iterations": 800, "inner": {"rate": 1, "cap": 3}})]
    assert text.variants(only_table(unnamed)) == []


def test_failed_cases_are_named_and_take_no_part():
    failed = of(seeds(1, method="b"), error="out of memory", metrics={}, images=())
    table = only_table([*seeds(), *failed])
    row = rows(table)["b"]
    assert row.note == "unranked: 0 seeds; seed 0 failed: out of memory"
    assert not row.cells
    everything = only_table(failed)
    assert everything.columns[0].key == "psnr"


def test_undefined_scores_are_a_dash_not_a_number():
    odd = of(seeds(method="b"), metrics={"psnr": math.nan, "ssim_3dgs": 0.5})
    table = only_table([*seeds(), *odd])
    assert [row.label for row in table.rows] == ["3dgs", "b"]
    assert rows(table)["b"].rank is None
    assert text.texts(table, rows(table)["b"])[2] == ("–", False)


def test_a_row_that_one_seed_leaves_without_a_rank_says_why():
    found = [rescored(one, "psnr", 24.0 + one.seed) for one in seeds(method="odd")]
    found[1] = rescored(found[1], "psnr", math.nan)
    odd = rows(only_table([*seeds(psnr=24.0), *found]))["odd"]
    assert odd.rank is None
    assert odd.note == "unranked: psnr is undefined in a seed"
    assert "psnr" not in odd.cells


def test_perfect_scores_are_infinite():
    images = tuple(
        ImageScore(name=n, truth_sha256="0", valid_share=1.0, metrics={"psnr": math.inf})
        for n in NAMES
    )
    table = only_table(of(seeds(), images=images, metrics={"psnr": math.inf}))
    assert text.texts(table, table.rows[0])[2] == ("∞", False)


def test_a_protocol_without_metrics_is_refused():
    with pytest.raises(DataError, match="name no metrics"):
        build_tables(of(seeds(), protocol_rules={"name": "p"}))


def test_the_result_does_not_depend_on_the_order_of_cases():
    assert build_tables(CLEAR) == build_tables(CLEAR[::-1])


def test_markdown_marks_the_best_and_says_the_rest():
    table = only_table([*CLEAR, *seeds(1, method="a|b", psnr=30.0)])
    shown = text.markdown([table])
    lines = shown.splitlines()
    table_lines = [line for line in lines if line.startswith("|")]
    assert len({line.replace("\\|", "").count("|") for line in table_lines}) == 1
    assert any(line.startswith("| 1 | better | **") for line in lines)
    assert "- a\\|b: unranked: 1 seed" in lines
    assert "better − worst: +" in shown
    assert "psnr [dB] ↑" in shown


def test_the_terminal_shows_every_number_that_markdown_shows():
    tables = [only_table([*CLEAR, *seeds(1, method="[red]x", psnr=30.0)])]
    file = io.StringIO()
    console = Console(file=file, width=200)
    console.print(text.terminal(tables, console.width))
    shown = file.getvalue()
    for row in tables[0].rows:
        for cell, _ in text.texts(tables[0], row):
            assert cell in shown
    assert "[red]x: unranked: 1 seed" in shown


@pytest.mark.parametrize("width", [50, 60, 80, 100, 160])
def test_a_narrow_terminal_breaks_tables_between_columns_and_no_number(width: int):
    table = only_table([*CLEAR, *seeds(1, method="with_a_long_name", psnr=30.0)])
    file = io.StringIO()
    console = Console(file=file, width=width)
    console.print(text.terminal([table], width))
    lines = file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    for row in table.rows:
        own = " ".join(line for line in lines if re.search(rf" {row.label} ", line))
        cells = [cell for cell, _ in text.texts(table, row)]
        for cell in cells[1:]:
            assert cell in own
    words = re.sub(r"\s", "", "".join(lines))
    assert "render[ms]" in words or width < 160
    for column in table.columns:
        pieces = [piece for piece in re.split(r"[_ ]", column.heading) if len(piece) > 1]
        assert all(piece in words for piece in pieces)


def test_every_column_is_explained_once_with_unit_and_arrow():
    rules = Protocol(name="all", source="ours", metrics=tuple(BUILT_IN), colour_fit=("cc_affine",))
    scored = [*BUILT_IN, *SCENE_METRICS, "cc_affine_psnr", "psnr_of_mean_mse", "moving_psnr"]
    results = [
        dataclasses.replace(
            one, metrics=dict.fromkeys(scored, 1.0), protocol_rules=dataclasses.asdict(rules)
        )
        for one in seeds()
    ]
    table = only_table(results)
    known = text.explained([table, table])
    assert list(known) == [*(column.heading for column in table.columns), "seeds"]
    assert all(len(about) > 10 and not about.endswith(".") for about in known.values())
    assert "not known" not in " ".join(known.values())
    assert known["psnr_of_mean_mse [dB] ↑"] != known["psnr [dB] ↑"]
    assert "affine" in known["cc_affine_psnr [dB] ↑"]
    assert "'moving'" in known["moving_psnr [dB] ↑"]
    shown = text.markdown([table])
    assert all(about.split("_")[0] in shown for about in known.values())


def test_the_record_for_machines_has_the_documented_keys():
    record = text.record(result())
    first = ["suite", "scene", "method", "variant", "pose_noise", "depth_prior", "seed",
             "protocol", "psnr", "ssim_3dgs"]  # fmt: skip
    assert list(record)[: len(first)] == first
    assert record["psnr"] == result().metrics["psnr"]
    assert record["train_seconds"] == result().stages["train"]
