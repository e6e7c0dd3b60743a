"""Claims: read from files, bound to printed cells, refused where they cannot be meant, judged and shown."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from splatproof.base.errors import UsageError
from splatproof.cli.claim_sources import known as installed
from splatproof.cli.claim_sources import of_runs
from splatproof.metrics.registry import all_metrics
from splatproof.metrics.scene_registry import SCENE_METRICS
from splatproof.reference.types.checked import Checked
from splatproof.reports.claims import claim as claim_module
from splatproof.reports.claims.claim import (
    HOUSE,
    CheckClaim,
    Claim,
    all_claims,
    claim_files,
    load_checks,
    load_claims,
)
from splatproof.reports.claims.obstacles import Known, method_of, obstacle
from splatproof.reports.claims.printed import Cells, effect_of, source_of
from splatproof.reports.findings.checks import LEAST, judge_check
from splatproof.reports.findings.finding import findings
from splatproof.reports.findings.page import ORDER, Shown, Sources, render_page
from splatproof.reports.findings.plot import draw_checks, draw_effects
from splatproof.reports.measured import Measured
from splatproof.reports.verdicts import judge
from splatproof.suites.claim_checks.registry import CHECKS
from splatproof.suites.published.rows import numbers

PAPERS = {"DPGS", "StratoSplat", "HDGS", "DLG-GS", "StitchGS"}
OF_CASES = {
    "disk_mb", "render_ms", "train_seconds", "cpu_seconds", "peak_memory_mb", "primitives", "points",
}  # fmt: skip
"""Values of cases that are no metric."""


@pytest.fixture(scope="module")
def every() -> tuple[Claim, ...]:
    return all_claims(numbers())[0]


@pytest.fixture(scope="module")
def known(every) -> Known:
    return installed(claim.suite for claim in every)


def test_there_are_claims_of_each_paper_and_our_own(every):
    counts = Counter(one.paper for one in every)
    assert set(counts) == PAPERS | {HOUSE}
    assert sum(counts[paper] for paper in PAPERS) >= 40
    assert min(counts[paper] for paper in PAPERS) >= 10
    own = [one for name in claim_files() for one in load_checks(name)]
    assert len(own) >= 10
    assert len({one.text for one in every}) == len(every)


def test_checks_of_claims_are_checks(every):
    own = [one.check for name in claim_files() for one in load_checks(name)]
    assert sorted(own) == sorted(CHECKS)  # none is measured for nothing, none is claimed twice


def test_claims_are_about_metrics_that_exist(every):
    named = {*all_metrics(), *SCENE_METRICS, *OF_CASES}
    for one in every:
        whole = one.metric.removeprefix("moving_").removeprefix("seen_")
        assert whole in named, one.text


def test_what_is_not_testable_lacks_a_method_or_a_suite_and_not_a_row(every, known):
    """A row of a method that exists, in a suite that exists, is a slip of the pen."""
    for one in every:
        if not one.missing and (found := obstacle(one, known)):
            assert "is not built" in found or "does not exist" in found, (one.text, found)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("HDGS is above PVG in novel views", 29.74 - 28.11),
        ("HDGS is stored in far fewer megabytes than PVG", 284 / 788 - 1),
        ("three layers take more time a frame than two", 54 / 47 - 1),
        ("soft merging (SIS) gains over a hard cut of the same blocks",
         (22.00 + 25.89 + 20.80 + 22.85 - 21.60 - 25.11 - 20.54 - 23.34) / 4),
        ("the opacity bias by depth gains on the neural field", 24.48 - 23.64),
        ("layered memory starts from fewer points than accumulation", 215607 / 778646 - 1),
        ("on top of dense initialisation side views lower LPIPS", 0.415 - 0.436),
        ("adapted colours alone (DLAAM) gain over Scaffold-GS",
         (26.7035 + 27.3773 + 24.3969 - 26.0471 - 26.1402 - 23.4969) / 3),
    ],
)  # fmt: skip
def test_printed_effects_are_those_of_the_papers(every, text: str, value: float):
    (one,) = (one for one in every if one.text == text)
    assert one.printed == pytest.approx(value)
    assert one.source.startswith("table")


def test_a_printed_loss_is_a_bar_where_no_more_is_claimed(every, tmp_path, monkeypatch):
    """More than the printed loss does not bear out a table that shows how small it is."""
    (one,) = (
        one
        for one in every
        if one.text == "noise L1 on all poses loses no more PSNR than is printed"
    )
    assert (one.bar, one.printed) == (pytest.approx(24.00 - 24.48), None)
    monkeypatch.setattr(claim_module, "FOLDER", tmp_path)
    turned = GOOD.replace("cells = ", "no_more = true\ncells = ")
    for old, new in (('"A"', '"_"'), ('"B"', '"A"'), ('"_"', '"B"')):
        turned = turned.replace(f"method = {old}", f"method = {new}")
    (tmp_path / "made.toml").write_text(turned)
    (loss,) = load_claims("made", LINES)
    assert (loss.bar, loss.printed, loss.source) == (
        -2.5,
        None,
        "table 1: psnr 20.5, 23, means of 2 scenes",
    )
    (tmp_path / "made.toml").write_text(
        GOOD.replace("cells = {", "no_more = true\nwhere = 'section 3'\n# {")
    )
    with pytest.raises(UsageError, match="no_more takes the printed cells"):
        load_claims("made", LINES)


def test_a_claims_printed_effect_is_never_typed(every):
    for one in every:
        assert one.source or one.paper == HOUSE, one.text
        assert (one.printed is None) == (one.cells is None or one.bar is not None)


LINES = [
    {"paper": "P", "table": t, "method": m, "variant": "", "dataset": "d", "scene": s,
     "metric": metric, "value": str(v), "note": note}
    for t, m, s, metric, v, note in (
        ("1", "A", "x", "psnr", 22.0, ""), ("1", "A", "y", "psnr", 24.0, ""),
        ("1", "B", "x", "psnr", 20.0, ""), ("1", "B", "y", "psnr", 21.0, ""),
        ("1", "C", "x", "psnr", 21.0, ""), ("1", "D", "x", "psnr", 9.0, "extraction suspect: 9"),
        ("1", "A", "x", "fps", 40.0, ""), ("1", "B", "x", "fps", 50.0, ""),
        ("2", "A", "x", "gain", 0.5, ""), ("3", "A", "x", "psnr", 1.0, ""), ("3", "A", "x", "psnr", 2.0, ""),
    )
]  # fmt: skip


def cells(
    row: str = "A", other: str = "B", metric: str = "psnr", table: str = "1", **more
) -> Cells:
    columns = {"method": other, **more} if other else {}
    return Cells(tables=(table,), metric=metric, row={"method": row, **more}, other=columns)


def effect(made: Cells, *, relative: bool = False, per_second: bool = False) -> float:
    return effect_of("P", made, relative, per_second, LINES, "here")


def test_effects_of_cells():
    assert effect(cells()) == pytest.approx(2.5)  # means over both scenes
    assert effect(cells(scene="x")) == pytest.approx(2.0)
    assert effect(cells(), relative=True) == pytest.approx(23 / 20.5 - 1)
    assert effect(cells(metric="fps"), relative=True, per_second=True) == pytest.approx(50 / 40 - 1)
    assert effect(cells(metric="fps"), relative=True) == pytest.approx(40 / 50 - 1)
    assert effect(cells(other="", metric="gain", table="2")) == 0.5
    assert source_of("P", cells(), LINES, "here") == "table 1: psnr 23, 20.5, means of 2 scenes"


@pytest.mark.parametrize(
    ("made", "told"),
    [
        (cells(other="C"), "printed for other scenes"), (cells(other="D", scene="x"), "extraction suspect"),
        (cells(row="E"), "no psnr of {'method': 'E'} in P, table 1"), (cells(table="3"), "two values"),
        (cells(colour="red"), "name column 'colour'"),
    ],
)  # fmt: skip
def test_cells_that_cannot_be_meant_are_refused(made: Cells, told: str):
    with pytest.raises(UsageError, match=told):
        effect(made)


GOOD = """suite = "street"
[[claims]]
paper = "P"
text = "a is better"
row = "a"
other = "b"
metric = "psnr"
cells = { tables = ["1"], metric = "psnr", row = { method = "A" }, other = { method = "B" } }
"""


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('metric = "psnr"\ncells', 'metric = "psnr"\nprinted = 1.0\ncells', "printed and source are computed"),
        ("cells = ", 'where = "section 3"\ncells = ', "cells of a table, or where it is said, and not both"),
        ('suite = "street"\n', "", "suite is missing"),
        ('row = "a"\n', "", "row is missing"),
        ('other = "b"\n', "", "without another row it needs a bar"),
        ('metric = "psnr"\ncells', 'metric = "psnr"\nbetter = "lower"\ncells', "printed 2.5 is not lower"),
        ('text = "a', 'txet = "a', "unknown 'txet', did you mean 'text'"),
        ("cells = ", "no_more = true\nbar = 1.0\ncells = ", "no_more takes the printed cells for its bar"),
    ],
)  # fmt: skip
def test_files_that_do_not_fit_are_refused(tmp_path, monkeypatch, old: str, new: str, told: str):
    monkeypatch.setattr(claim_module, "FOLDER", tmp_path)
    (tmp_path / "made.toml").write_text(GOOD)
    (one,) = load_claims("made", LINES)
    assert (one.suite, one.printed) == ("street", 2.5)
    assert old in GOOD
    (tmp_path / "made.toml").write_text(GOOD.replace(old, new))
    with pytest.raises(UsageError, match=told):
        load_claims("made", LINES)


def test_a_file_says_for_all_of_its_claims_how_often_photos_are_to_be_visited(
    tmp_path, monkeypatch, every
):
    assert {one.visits for one in every if one.suite == "city"} == {40}
    monkeypatch.setattr(claim_module, "FOLDER", tmp_path)
    own = GOOD + GOOD.partition("\n")[2].replace("a is", "b is") + "visits = 9\n"
    (tmp_path / "made.toml").write_text(f"visits = 40\n{own}")
    assert [one.visits for one in load_claims("made", LINES)] == [40, 9]


CLAIM = Claim(
    paper="P", text="a is better", suite="s", row="a", other="b", metric="psnr", printed=1.0
)
KNOWN = Known(
    methods=frozenset({"a", "b"}),
    suites={"s": frozenset({("x", "p", "a"), ("x", "p", "b"), ("y", "p", "a")})},
)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({}, ""), ({"row": "c@v~depth-oracle"}, "method c is not built"),
        ({"row": "c", "other": "d"}, "method c is not built; method d is not built"),
        ({"suite": "t"}, "suite t does not exist"),
        ({"suite": "t", "row": "c"}, "method c is not built; suite t does not exist"),
        ({"row": "a@v"}, "suite s has no row a@v"), ({"protocol": "q"}, "suite s has no a under protocol q"),
        ({"scenes": ("y",)}, "suite s has no b on y"), ({"other": "", "bar": 1.0}, ""),
    ],
)  # fmt: skip
def test_what_is_missing_is_found_and_not_written(changed, told):
    assert obstacle(replace(CLAIM, **changed), KNOWN) == told
    assert method_of("a@v~x") == "a"


def runs(value: float, row: str = "a", seeds: int = 3, **changed) -> list[Measured]:
    rng = np.random.default_rng(3)
    return [
        Measured(scene="x", row=row, protocol="p", seed=seed, steps=9, grown=2, late_gain=0.0, data="d",
                 machine="cores 2", values={"psnr": value + rng.normal(0, 0.01)}, **changed)
        for seed in range(seeds)
    ]  # fmt: skip


def found_of(claims: list[Claim], own: list[Measured], **checked: Checked) -> list:
    return findings(claims, [], {"s": own}, checked, KNOWN)


def test_findings_say_what_stands_behind_a_verdict():
    (one,) = found_of([CLAIM], [*runs(21.0), *runs(20.0, "b")])
    assert one.verdict == "holds"
    assert one.effect == pytest.approx(1.0, abs=0.05)
    assert one.runs[0] == "s/x/a/p/seed0"
    assert len(one.runs) == 6
    assert one.asked == "+1"
    assert one.here.startswith("+1")
    assert one.record()["verdict"] == "holds"


def test_rows_that_were_run_are_judged_whatever_the_installation_has():
    claim = replace(CLAIM, row="new", other="b")
    own = [*runs(21.0, "new"), *runs(20.0, "b")]
    assert [f.verdict for f in found_of([claim], own)] == ["holds"]
    (missing,) = found_of([claim], runs(20.0, "b"))
    assert (missing.verdict, missing.reason) == ("not testable here", "method new is not built")
    (unrun,) = found_of([CLAIM], runs(20.0, "b"))
    assert unrun.reason == "a has not been run"


def test_runs_that_are_too_few_and_never_densified_say_both():
    own = [*runs(21.0, seeds=1), *runs(20.0, "b", seeds=1)]
    flat = [replace(one, grown=0) for one in own]
    assert found_of([CLAIM], own)[0].reason == "1 seed; 3 are needed"
    assert found_of([CLAIM], flat)[0].reason == "1 seed; 3 are needed; a, b: never densified"
    unknown = [replace(one, grown=-1) for one in own]  # rows of pages that did not keep it
    assert found_of([CLAIM], unknown)[0].reason == "1 seed; 3 are needed"


def test_what_is_settled_before_training_minds_no_density_control():
    flat = [replace(one, grown=0, late_gain=9.0) for one in [*runs(21.0), *runs(20.0, "b")]]
    assert found_of([CLAIM], flat)[0].verdict == "too short to judge"
    assert found_of([replace(CLAIM, before_training=True)], flat)[0].verdict == "holds"


@pytest.mark.parametrize(
    ("bar", "verdict"), [(19.0, "holds"), (22.0, "contradicted"), (21.0, "undecided")]
)
def test_a_row_by_itself_is_held_against_the_bar(bar: float, verdict: str):
    claim = replace(CLAIM, other="", printed=None, bar=bar)
    found = judge(claim, runs(21.0), np.random.default_rng(0))
    assert found.verdict == verdict
    assert found.difference is not None
    assert found.difference.mean == pytest.approx(21.0, abs=0.05)


OWN = CheckClaim(text="fast", check="speed", better="higher", bar=2.0, by="median")


def checked(*values: float, **changed) -> Checked:
    return Checked(check="speed", values=values, unit="times", compared="a over b", **changed)


@pytest.mark.parametrize(
    ("values", "by", "better", "verdict"),
    [
        ([3.0, 3.1, 2.9, 3.2, 2.8, 3.0], "median", "higher", "holds"),
        ([1.0, 1.1, 0.9, 1.2, 0.8, 1.0], "median", "higher", "contradicted"),
        ([1.0, 3.1, 0.9, 3.2, 2.8, 1.0], "median", "higher", "undecided"),
        ([3.0] * (LEAST - 1), "median", "higher", "too short to judge"),
        ([1.0] * LEAST, "median", "lower", "holds"),
        ([2.0, 3.0], "every", "higher", "holds"), ([1.9, 3.0], "every", "higher", "contradicted"),
        ([2.0, 0.0], "every", "lower", "holds"), ([2.1, 0.0], "every", "lower", "contradicted"),
        ([], "every", "lower", "not testable here"), ([math.inf], "every", "higher", "not testable here"),
    ],
)  # fmt: skip
def test_verdicts_of_checks(values, by, better, verdict):
    claim = replace(OWN, by=by, better=better)
    assert judge_check(claim, checked(*values)).verdict == verdict


def test_a_check_without_a_measurement_says_why():
    assert judge_check(OWN, None).reason == "check speed: has not been run"
    assert judge_check(OWN, checked(error="no gsply")).reason == "check speed: no gsply"
    assert judge_check(replace(OWN, missing="no disk"), checked(3.0)).reason == "no disk"
    worst = judge_check(replace(OWN, by="every", better="lower"), checked(1.0, 9.0, 3.0))
    assert (worst.value, worst.low, worst.high) == (9.0, 1.0, 9.0)
    assert worst.reason == "1 of 3 values reach the bar; a over b"


def test_the_median_lies_in_its_interval_as_often_as_stated():
    """The interval between order statistics covers at least 95 %: a wrong quantile would not."""
    rng, trials = np.random.default_rng(0), 150
    inside = 0
    for _ in range(trials):
        found = judge_check(OWN, checked(*rng.lognormal(size=15)))
        inside += found.low <= 1.0 <= found.high
    assert inside / trials >= 0.95 - 3 * math.sqrt(0.05 * 0.95 / trials)


def some_findings():
    against = [*runs(19.0), *runs(20.0, "b")]
    made = [CLAIM, replace(CLAIM, text="c is better | much", row="c"),
            replace(CLAIM, paper=HOUSE, text="ours", printed=None, bar=-2.0)]  # fmt: skip
    return findings(made, [OWN], {"s": against}, {"speed": checked(*[3.0] * LEAST)}, KNOWN)


def test_the_page_begins_with_what_went_against_a_paper():
    sources = Sources(
        pictures={"s": [Shown(path="i/a.jpg", caption="a, x: seed 0"), Shown(path="i/curves.png", caption="C")]},
        charts=[Shown(path="i/checks.png", caption="All")], machines=["cores 2"],
    )  # fmt: skip
    text = render_page(some_findings(), sources)
    assert "the committed rows of the suites' pages\n(s.json) and of the checks" in text
    assert "| P | 2 | 1 |  |  |  |  |  | 1 |" in text
    assert "| this project | 2 |  |  |  |  | 2 |  |  |" in text
    head, rest = text.split("## P\n")
    assert head.index("What came out against its claim") < head.index(
        "| **contradicted** | **a is better**"
    )
    assert "[a](i/a.jpg) [curves](i/curves.png) [s](s.md#pictures)" in head
    assert "- **method c is not built**\n  - c is better | much: +1" in rest
    assert "[chart](i/checks.png)" in rest
    assert "| **holds** | **fast**<br>check `speed` | at least 2 | 3 | 6 |" in rest


def test_the_page_of_nothing_measured():
    text = render_page(found_of([CLAIM], []), Sources(pictures={}, charts=[], machines=[]))
    assert "Of 1 claims of the papers: **none can be judged yet**; 1 are not testable here." in text
    assert "the committed rows of the suites' pages\n(none yet) and of the checks" in text
    assert "Measured on nothing yet" in text
    assert "Nothing so far." in text
    assert len(ORDER) == 7


def test_charts_show_what_was_measured(tmp_path):
    assert draw_effects(some_findings(), tmp_path / "a" / "effects.png")
    assert draw_checks(some_findings(), tmp_path / "checks.png")
    assert (tmp_path / "a" / "effects.png").read_bytes()[:4] == b"\x89PNG"
    assert not draw_effects(found_of([CLAIM], []), tmp_path / "none.png")
    assert not draw_checks(found_of([CLAIM], []), tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def test_a_store_is_judged_as_its_folder_is(suite_folder):
    def values(found):
        return {
            name: sorted((r.scene, r.row, r.seed, str(r.values)) for r in own)
            for name, own in found.runs.items()
        }

    of_folder = of_runs(suite_folder, ["quick", "street"])
    of_store = of_runs(f"sqlite:///{suite_folder}/mlflow.db", ["quick", "street"])
    assert len(of_folder.runs["quick"]) == 18
    assert values(of_folder) == values(of_store)
