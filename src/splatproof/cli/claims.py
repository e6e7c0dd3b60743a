"""`bench claims`: what the papers and this project claim, and what runs and checks say of it."""

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import tyro

from splatproof.base.errors import UsageError
from splatproof.base.files import read_json
from splatproof.base.names import unknown
from splatproof.cli import output
from splatproof.reports.verdicts import Verdict

if TYPE_CHECKING:
    from splatproof.cli.claim_sources import Evidence
    from splatproof.reports.claims.claim import CheckClaim, Claim
    from splatproof.reports.findings.finding import Finding
    from splatproof.reports.findings.page import Sources

PIPED_WIDTH = 160
"""Characters a line where stdout is no terminal."""


def claims(
    *,
    paper: str | None = None,
    suite: str | None = None,
    verdict: Verdict | None = None,
    runs: str | None = None,
    run: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    out: Path = Path("runs"),
    page: Path | None = None,
) -> int:
    """Judge what five papers print and what this project says of itself.

    A claim names two rows of a suite and the effect that a paper prints, or a check and a bar. The
    verdict is one of: holds, direction only, no difference, contradicted, undecided, too short to
    judge, not testable here (with what is missing). Without --runs and --run it is judged by the rows
    that are committed with this project. With --json each claim is a line: paper, text, source, verdict,
    reason, suite, check, rows, metric, protocol, relative, printed, bar, effect, low, high, seeds, runs.

    Args:
        paper: Only the claims of this paper, e.g. HDGS; "house": this project's own.
        suite: Only the claims about rows of this suite; "checks": only those that checks measure.
        verdict: Only the claims with this verdict.
        runs: Judge by these runs: a folder that `bench run` calls OUT, or a tracking URI.
        run: First run the cases and checks behind these claims that OUT does not hold; it says before
            how long that takes, and continues where it was stopped.
        quick: With --run or --runs: the reduced forms of suites and checks, which take a few minutes and
            judge next to nothing.
        out: Folder of the runs with --run.
        page: Also write the page of all claims to this file, from the rows beside it; checks that were
            measured with --run or --runs go to claims_checks.json beside it first.
    """
    from splatproof.cli import claim_sources
    from splatproof.reports.claims.claim import all_claims
    from splatproof.suites.published.rows import numbers

    _check_options(runs, run, quick, page, (paper, suite, verdict))
    every, checks = _chosen(*all_claims(numbers()), paper, suite)
    suites = [claim.suite for claim in every]
    failed = 0
    if not run and runs is None:
        evidence = claim_sources.committed(
            page.parent if page else claim_sources.docs_folder(), suites
        )
    else:
        if quick:
            every = claim_sources.in_quick_form(every, claim_sources.known(suites).suites)
        if run:
            failed = _run(every, checks, out, quick)
        evidence = claim_sources.of_runs(out if run else str(runs), suites, quick=quick)
    if page:
        write_page(page, evidence if run or runs is not None else None)
    found = claim_sources.judged(every, checks, evidence)
    _print([one for one in found if verdict in (None, one.verdict)])
    return int(bool(failed))


def _check_options(
    runs: str | None, run: bool, quick: bool, page: Path | None, filters: tuple[str | None, ...]
) -> None:
    """Refuse options that contradict each other. Raises: UsageError."""
    if run and runs is not None:
        raise UsageError("--run writes to --out and judges by it; leave --runs out")
    if quick and not run and runs is None:
        raise UsageError("--quick is about runs; add --run, or --runs FOLDER")
    if page and (quick or any(filters)):
        raise UsageError(
            "--page shows all claims; leave --quick, --paper, --suite and --verdict out"
        )


def _chosen(
    every: "tuple[Claim, ...]", checks: "tuple[CheckClaim, ...]", paper: str | None,
    suite: str | None,
) -> "tuple[list[Claim], list[CheckClaim]]":  # fmt: skip
    """The claims of a paper about a suite. Raises: UsageError for a name that no claim has."""
    from splatproof.reports.claims.claim import HOUSE

    papers = {claim.paper for claim in every} | {HOUSE}
    suites = {claim.suite for claim in every} | {"checks"}
    if paper is not None and paper not in papers:
        raise unknown("--paper", paper, sorted(papers))
    if suite is not None and suite not in suites:
        raise unknown("--suite", suite, sorted(suites))
    rows = [c for c in every if paper in (None, c.paper) and suite in (None, c.suite)]
    return rows, list(checks) if paper in (None, HOUSE) and suite in (None, "checks") else []


def _run(every: "list[Claim]", checks: "list[CheckClaim]", out: Path, quick: bool) -> int:
    """Run what is missing; number of cases that failed."""
    from splatproof.cli import claim_running
    from splatproof.cli.claim_sources import known

    work = claim_running.work_for(
        every, checks, known(one.suite for one in every), out, quick=quick
    )
    out.mkdir(parents=True, exist_ok=True)
    claim_running.tell(work, out, quick=quick)
    return claim_running.run(work, out, quick=quick)


def _print(found: "list[Finding]") -> None:
    """The claims on stdout: a table, or a JSON object each."""
    if output.wants_json():
        for one in found:
            output.print_record(one.record())
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("verdict", "paper", "claim", "printed", "here, 95 % interval", "seeds", "why"):
        table.add_column(heading, overflow="fold")
    for one in found:
        cells = (
            one.verdict,
            one.paper,
            one.text,
            one.asked,
            one.here,
            str(one.seeds or ""),
            one.reason,
        )
        table.add_row(*cells)
    Console(
        width=None if sys.stdout.isatty() else PIPED_WIDTH, highlight=False, markup=False
    ).print(table)
    counts = Counter(one.verdict for one in found)
    total = ", ".join(f"{counts[name]} {name}" for name in get_args(Verdict) if counts[name])
    output.print_text(f"{len(found)} claims: {total or 'none fits'}")


def write_page(page: Path, measured: "Evidence | None" = None) -> None:
    """Write the page of all claims and its charts, from the rows beside it.

    Args:
        page: Markdown file; SUITE.json, SUITE_pictures.json and claims_checks.json lie beside it.
        measured: Checks that replace those of the same names there.
    """
    from splatproof.base.files import write_text
    from splatproof.cli.claim_sources import CHECKS_NAME, read_checked, write_checked
    from splatproof.reports.findings.plot import draw_checks, draw_effects

    folder = page.parent
    path = folder / CHECKS_NAME
    new = {n: one for n, one in (measured.checked if measured else {}).items() if not one.reduced}
    if new or not path.exists():
        write_checked(path, read_checked(path) | new)
    found, _ = of_page(folder)
    for draw, name in ((draw_effects, "effects"), (draw_checks, "checks")):
        draw(found, folder / "images" / "claims" / f"{name}.png")
    write_text(page, page_text(folder))
    output.log(f"written: {page}")


def of_page(folder: Path) -> "tuple[list[Finding], Evidence]":
    """Every claim with what the rows of a folder say of it, and these rows.

    Args:
        folder: As of `write_page`.
    """
    from splatproof.cli.claim_sources import committed, judged
    from splatproof.reports.claims.claim import all_claims
    from splatproof.suites.published.rows import numbers

    every, checks = all_claims(numbers())
    evidence = committed(folder, [claim.suite for claim in every])
    return judged(every, checks, evidence), evidence


def page_text(folder: Path) -> str:
    """The page of the rows and pictures of a folder.

    Args:
        folder: As of `write_page`.
    """
    from splatproof.reports.findings.page import render_page

    found, evidence = of_page(folder)
    return render_page(found, _sources(folder, evidence))


CHARTS = {
    "effects": "Measured effects in units of the printed ones: 0 is none, 1 what the paper prints; green from half.",
    "checks": "What checks measured, as multiples of what is asked; the claimed side is on the right.",
}
"""Charts of the page by the name of the file."""


def _sources(folder: Path, evidence: "Evidence") -> "Sources":
    """What the page may link to."""

    from splatproof.reports.findings.page import Shown, Sources

    pictures = {}
    for name in evidence.runs:
        listing = folder / f"{name}_pictures.json"
        if listing.is_file():
            shown = read_json(listing)
            pictures[name] = [Shown(path=one["path"], caption=one["caption"]) for one in shown]
    charts = [
        Shown(path=f"images/claims/{name}.png", caption=caption)
        for name, caption in CHARTS.items()
        if (folder / "images" / "claims" / f"{name}.png").is_file()
    ]
    return Sources(pictures=pictures, charts=charts, machines=evidence.machines)
