"""`bench claims`: committed rows, other runs, filters, the page, and what it would run."""

import json
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from helpers import case_folders
from helpers.printed_rows import rows_of
from splatproof.cli import claim_running, claim_sources, claims, main
from splatproof.cli.claim_sources import CHECKS_NAME, committed, read_checked, write_checked
from splatproof.reference.types.checked import Checked
from splatproof.reports.claims import claim as claim_module
from splatproof.reports.claims.claim import CheckClaim, Claim, all_claims
from splatproof.reports.measured import measured_row
from splatproof.suites import suite_files
from splatproof.suites.claim_checks.registry import CHECKS
from splatproof.suites.published.rows import numbers
from splatproof.suites.records import write_record
from splatproof.suites.suite_files import load_suite

DOCS = Path(__file__).parents[2] / "docs"

suite_of = cache(load_suite)
claims_of = cache(lambda: all_claims(numbers()))


@pytest.fixture(autouse=True)
def _read_once(monkeypatch: pytest.MonkeyPatch):
    """The package's suites and claims are the same in every test: reading them takes seconds."""
    monkeypatch.setattr(suite_files, "load_suite", suite_of)
    monkeypatch.setattr(claim_module, "all_claims", lambda _: claims_of())


def test_the_committed_page_is_what_the_command_makes_of_the_committed_rows():
    assert (DOCS / "claims.md").read_text(encoding="utf-8") == claims.page_text(DOCS)


def test_the_page_names_every_file_of_rows_that_claims_are_made_of():
    suites = {claim.suite for claim in claims_of()[0]}
    text = (DOCS / "claims.md").read_text(encoding="utf-8")
    listed = text.split("pages\n(")[1].split(")")[0].split()
    assert {name.rstrip(",") for name in listed} == {f"{name}.json" for name in suites}


def test_every_check_is_measured_whole_and_every_chart_is_there():
    found = read_checked(DOCS / CHECKS_NAME)
    assert set(found) == set(CHECKS)
    assert not any(one.reduced for one in found.values())
    for name in claims.CHARTS:
        # a line for each printed effect with an interval, 70 by now and 95 at most: 4.3 kB each
        assert (DOCS / "images" / "claims" / f"{name}.png").stat().st_size < 95 * 4_400


def test_links_of_the_page_lead_somewhere():
    text = (DOCS / "claims.md").read_text(encoding="utf-8")
    links = {part.split(")")[0].split("#")[0] for part in text.split("](")[1:]}
    assert len(links) > 10
    for link in links:
        assert (DOCS / link).is_file(), link


def test_claims_are_chosen_by_paper_suite_and_verdict(capsys):
    own = rows_of(["claims", "--paper", "HDGS", "--verdict", "holds"], capsys)
    assert own
    assert {(one["paper"], one["verdict"]) for one in own} == {("HDGS", "holds")}
    assert own[0]["runs"]
    checks = rows_of(["claims", "--suite", "checks"], capsys)
    assert sorted(one["check"] for one in checks) == sorted(CHECKS)
    assert main(["claims", "--paper", "DPGS", "--suite", "city"]) == 0
    shown = capsys.readouterr().out
    assert "2 claims: 2 holds" in shown
    assert "StitchGS" not in shown


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--paper", "HDG"], "--paper: unknown 'HDG', did you mean 'HDGS'"),
        (["--suite", "stret"], "--suite: unknown 'stret', did you mean 'street'"),
        (["--run", "--runs", "x"], "--run writes to --out"),
        (["--quick"], "--quick is about runs"),
        (["--page", "x.md", "--paper", "HDGS"], "--page shows all claims"),
        (["--runs", "nowhere"], "nowhere: no such folder"),
    ],
)  # fmt: skip
def test_options_that_cannot_be_meant_are_refused(arguments, told, capsys):
    assert main(["claims", *arguments]) == 2
    assert told in " ".join(capsys.readouterr().err.split())


def test_an_installed_package_says_what_is_missing(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(
        claim_sources.splatproof, "__file__", str(tmp_path / "a" / "b" / "__init__.py")
    )
    assert main(["claims"]) == 3
    assert "an installed package has no docs folder" in capsys.readouterr().err


HARD, REFINED = "stitchgs@tuned-hard-double", "stitchgs@tuned-gcr-double"


def city(row: str, seed: int):
    """A result of the suite city: its names, and a seam."""
    psnr = {HARD: 20.0, REFINED: 22.0}[row] + 0.01 * seed
    method, _, variant = row.partition("@")
    return replace(
        case_folders.result(scene="caliterra", method=method, seed=seed),
        suite="city", variant=variant, protocol="city_400",
        metrics={"psnr": psnr, "seam_psnr_partition": psnr}, settings={"iterations": 400, "blocks": 4},
        curve=tuple((step, {"gaussians": float(step), "loss": 1.0}) for step in range(1, 30)),
    )  # fmt: skip


@pytest.fixture
def city_runs(tmp_path: Path) -> Path:
    for row in (HARD, REFINED):
        for seed in range(3):
            write_record(tmp_path / "city" / "caliterra" / row / f"seed{seed}", city(row, seed))
    return tmp_path


def test_other_runs_are_judged(city_runs: Path, capsys):
    found = rows_of(["claims", "--suite", "city", "--runs", str(city_runs)], capsys)
    verdicts = {one["text"]: one for one in found}
    one = verdicts["the stitched model is at least 1 dB above the hard cut at the seam"]
    assert (one["verdict"], one["seeds"], len(one["runs"])) == ("holds", 3, 6)
    assert one["effect"] == pytest.approx(2.0)
    other = verdicts["refinement (GCR) gains over merging alone"]
    assert (other["verdict"], other["reason"]) == (
        "not testable here", "stitchgs@tuned-merge-double has not been run"
    )  # fmt: skip


def test_damaged_rows_are_told(tmp_path: Path, capsys):
    shutil.copy(DOCS / CHECKS_NAME, tmp_path)
    (tmp_path / "city.json").write_text('[{"scene": "s"}]')
    assert main(["claims", "--page", str(tmp_path / "claims.md")]) == 2
    assert "not a row of measured values" in capsys.readouterr().err
    (tmp_path / CHECKS_NAME).write_text('[{"check": "a"}]')
    (tmp_path / "city.json").write_text("[")
    assert main(["claims", "--page", str(tmp_path / "claims.md")]) == 2
    assert "not JSON" in capsys.readouterr().err


def test_rows_of_pages_that_kept_less_are_read():
    found = measured_row(
        {"scene": "s", "row": "a", "protocol": "p", "seed": 1, "iterations": 7, "blocks": 4}
    )
    assert (found.steps, found.grown) == (7, -1)


def test_measured_checks_are_kept_and_given_to_the_page(tmp_path: Path):
    one = Checked(check="same_seed", values=(0.0,), unit="bytes", compared="x", machine="m")
    reduced = replace(one, check="threads", reduced=True)
    write_checked(tmp_path / "runs" / CHECKS_NAME, {"same_seed": one, "threads": reduced})
    assert read_checked(tmp_path / "runs" / CHECKS_NAME)["same_seed"] == one
    evidence = claim_sources.of_runs(tmp_path / "runs", ["street"])
    claims.write_page(tmp_path / "claims.md", evidence)
    assert set(read_checked(tmp_path / CHECKS_NAME)) == {
        "same_seed"
    }  # the reduced form judges nothing
    text = (tmp_path / "claims.md").read_text()
    assert "| **holds** | **one seed gives the same model twice" in text
    assert committed(tmp_path, ["street"]).runs == {}


def claim(**changed: Any) -> Claim:
    plain: dict[str, Any] = {"paper": "P", "text": "t", "suite": "tunnel", "row": "scaffold-gs", "other": "3dgs",
                             "metric": "psnr", "protocol": "tunnel"}  # fmt: skip
    return Claim(**{**plain, **changed})


def test_what_runs_is_what_the_claims_are_about_and_its_other_lengths(tmp_path: Path):
    known = claim_sources.known(["tunnel", "sparse", "city"])
    work = claim_running.work_for([claim()], [], known, tmp_path, quick=False)
    (suite,) = work.suites
    assert {case.row for case in suite.cases} == {
        "scaffold-gs",
        "3dgs",
        "scaffold-gs@half",
        "scaffold-gs@double",
        "3dgs@half",
    }
    assert {case.protocol.name for case in suite.cases} == {"tunnel"}
    none = [claim(row="unknown"), claim(suite="nowhere"), claim(missing="time")]
    assert claim_running.work_for(none, [], known, tmp_path, quick=False).suites == ()


def test_rows_of_other_lengths_are_needed_too():
    """Whether real scenes are there or not: of the suite as it is planned."""
    wanted = claim(suite="city", row="stitchgs", protocol="city_400", scenes=("caliterra",))
    rows = {case.row for case in suite_of("city").cases if claim_running._wanted(case, [wanted])}
    methods = ("stitchgs", "3dgs")
    lengths = {f"{method}@{length}" for method in methods for length in ("half", "double")}
    assert rows == lengths | set(methods)


def test_of_a_variant_its_own_lengths_are_needed_and_of_its_method_no_other_variant_s():
    wanted = claim(
        suite="city",
        row="odbp+stitch@tuned",
        other="3dgs",
        protocol="city_400",
        scenes=("caliterra",),
    )
    rows = {case.row for case in suite_of("city").cases if claim_running._wanted(case, [wanted])}
    lengths = {
        "odbp+stitch@tuned-half",
        "odbp+stitch@tuned-double",
        "odbp+stitch@half",
        "odbp+stitch@double",
        "3dgs@half",
        "3dgs@double",
    }
    assert rows == lengths | {"odbp+stitch@tuned", "3dgs"}


def test_the_reduced_form_runs_reduced_suites_and_checks_once(tmp_path: Path):
    known = claim_sources.known(["tunnel", "minute", "city"])
    check = CheckClaim(text="t", check="same_seed", better="lower", bar=0.0)
    reduced = claim_sources.in_quick_form([claim(), claim(suite="minute")], known.suites)
    work = claim_running.work_for(reduced, [check], known, tmp_path, quick=True)
    assert [suite.name for suite in work.suites] == ["tunnel-quick"]
    assert work.notes == ("suite minute has no reduced form",)
    assert work.checks == ("same_seed",)
    done = Checked(check="same_seed", values=(0.0,), unit="", compared="", reduced=True)
    write_checked(tmp_path / CHECKS_NAME, {"same_seed": done})
    assert claim_running.work_for([], [check], known, tmp_path, quick=True).checks == ()
    assert claim_running.work_for([], [check], known, tmp_path, quick=False).checks == (
        "same_seed",
    )


def test_a_reduced_form_under_another_protocol_is_judged(tmp_path: Path):
    known = claim_sources.known(["tunnel", "sparse", "city"])
    one, other = claim_sources.in_quick_form(
        [claim(suite="city", protocol="city_400"),
         claim(suite="sparse", protocol="photos_sparse_3")], known.suites
    )  # fmt: skip
    assert (one.protocol, other.protocol) == ("", "photos_sparse_3")


def test_running_tells_how_long_it_takes_and_keeps_what_is_there(
    tmp_path: Path, capsys, monkeypatch
):
    """The cheapest check stands for all: what is run is kept, and not run again."""
    only = CHECKS["colour_error"]
    monkeypatch.setattr(
        claim_running,
        "work_for",
        lambda *a, **k: claim_running.Work(
            suites=(),
            checks=() if (tmp_path / CHECKS_NAME).exists() else ("colour_error",),
            notes=("why",),
        ),
    )
    for expected in ("1 checks to run", "0 checks to run"):
        code = main(
            ["claims", "--run", "--quick", "--suite", "checks", "--out", str(tmp_path), "--json"]
        )
        told = capsys.readouterr()
        assert code == 0
        assert expected in told.err
        assert "not run: why" in told.err
        found = {one["check"]: one for one in map(json.loads, told.out.splitlines())}
        assert found["colour_error"]["verdict"] == "holds"
        assert found["same_seed"]["reason"] == "check same_seed: has not been run"
    assert only.seconds[1] < only.seconds[0]
