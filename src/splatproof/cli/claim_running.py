"""What `bench claims --run` runs: the cases and checks that claims are about and that are not there yet."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from splatproof.base.errors import MissingError
from splatproof.cli import output
from splatproof.cli.claim_sources import CHECKS_NAME, QUICK, read_checked, write_checked
from splatproof.cli.running import USUAL, USUAL_BLOCKS, Screen, options, prepare
from splatproof.reports.claims.claim import CheckClaim, Claim
from splatproof.reports.claims.obstacles import Known, obstacle
from splatproof.reports.verdicts import other_length
from splatproof.suites.records import read_finished
from splatproof.suites.suite_files import Case, Suite


@dataclass(frozen=True, kw_only=True)
class Work:
    """What there is to run."""

    suites: tuple[Suite, ...]
    """Suites with those of their cases that claims are about."""
    checks: tuple[str, ...]
    """Names of the checks that have not been run."""
    notes: tuple[str, ...]
    """What cannot be run and why."""


def work_for(
    claims: Sequence[Claim], checks: Sequence[CheckClaim], known: Known, out: Path, *, quick: bool
) -> Work:
    """The cases and checks behind claims, without those that nothing here can run.

    Args:
        claims: Claims about rows of suites; in the reduced form as `in_quick_form` gives them.
        checks: Claims that checks measure.
        known: Methods and suites of this installation.
        out: Folder of the runs: checks that were measured there are not run again.
        quick: The reduced form of each suite, and of each check.
    """
    from splatproof.suites.scenes import without_absent
    from splatproof.suites.suite_files import load_suite

    testable = [
        one for one in claims if not one.missing and not (obstacle(one, known) and not quick)
    ]
    suites, notes = [], []
    for name in dict.fromkeys(one.suite for one in testable):
        form = f"{name}{QUICK}" if quick else name
        if form not in known.suites:
            if name in known.suites:
                notes.append(f"suite {name} has no reduced form")
            continue
        whole = load_suite(form)
        cases = tuple(
            c for c in whole.cases if _wanted(c, [o for o in testable if o.suite == name])
        )
        if not cases:
            continue
        try:
            here, absent = without_absent(replace(whole, cases=cases))
        except MissingError as error:
            notes.append(str(error))
            continue
        notes += absent
        suites.append(here)
    measured = read_checked(out / CHECKS_NAME)
    lacking = tuple(
        one.check for one in checks
        if one.check not in measured or measured[one.check].reduced != quick
    )  # fmt: skip
    return Work(suites=tuple(suites), checks=lacking, notes=tuple(dict.fromkeys(notes)))


def _wanted(case: Case, claims: Iterable[Claim]) -> bool:
    """Whether a claim is about the case, or needs it to see if the runs were long enough."""
    for claim in claims:
        rows = claim.rows
        of_a_row = any(_of_other_length(case, row) for row in rows)
        fits = not claim.protocol or claim.protocol == case.protocol.name
        there = not claim.scenes or case.scene_name in claim.scenes
        if (case.row in rows or of_a_row) and fits and there:
            return True
    return False


def _of_other_length(case: Case, row: str) -> bool:
    """Whether a case is a row, or what the row is a variant of, with half or twice the steps."""
    stem, length = other_length(case.variant)
    method, _, variant = row.partition("~")[0].partition("@")
    return (
        bool(length)
        and method == case.method
        and f"{variant}-".startswith(f"{stem}-" if stem else "")
    )


def tell(work: Work, out: Path, *, quick: bool) -> None:
    """Say what will be run and about how long it takes, before anything is.

    Args:
        work: What there is to run.
        out: Folder of the runs.
        quick: Whether it is the reduced form.
    """
    from splatproof.suites.claim_checks.registry import CHECKS
    from splatproof.suites.estimate import estimate_suite
    from splatproof.suites.scenes import not_made, without_side_effects

    total = 0.0
    for suite in work.suites:
        there = {
            (one.scene, one.row, one.protocol, one.seed) for one in read_finished(out / suite.name)
        }
        unmade = not_made(suite)
        left = [
            c for c in suite.cases if (c.scene_name, c.row, c.protocol.name, c.seed) not in there
        ]
        known = tuple(case for case in left if case.scene not in unmade)
        plain = without_side_effects(replace(suite, cases=known))
        seconds = sum(guess.seconds for guess in estimate_suite(plain, out, USUAL.backend))
        total += seconds
        waiting = f", {len(left) - len(known)} more on scenes to be made" if unmade else ""
        output.log(
            f"suite {suite.name}: {len(left)} of {len(suite.cases)} cases to run, about {seconds:.0f} s"
            f"{waiting}"
        )
    seconds = sum(CHECKS[name].seconds[quick] for name in work.checks)
    output.log(f"{len(work.checks)} checks to run, about {seconds:.0f} s")
    output.log(
        f"about {total + seconds:.0f} s in all; what is finished is kept, however it is stopped"
    )
    for note in work.notes:
        output.log(f"not run: {note}")


def run(work: Work, out: Path, *, quick: bool) -> int:
    """Run it; the same call continues where it was stopped.

    Args:
        work: What there is to run.
        out: Folder of the runs; checks are kept in claims_checks.json there.
        quick: Whether it is the reduced form.
    Returns: Number of cases that failed.
    """
    from splatproof.suites.claim_checks.registry import run_check
    from splatproof.suites.runner import run_suite

    # a process a block takes longer to start and to end than the few steps of a reduced form
    blocks = replace(USUAL_BLOCKS, engine="inline") if quick else USUAL_BLOCKS
    failed = 0
    for suite in work.suites:
        prepare(suite)
        with output.progress() as bar:
            screen = Screen(bar, lambda outcome: None)
            outcomes = run_suite(
                suite, out, on_progress=screen.progress, on_result=screen.result,
                **options(USUAL, blocks),
            )  # fmt: skip
        failed += sum(outcome.status == "failed" for outcome in outcomes)
    path = out / CHECKS_NAME
    for name in work.checks:
        found = run_check(name, reduced=quick)
        write_checked(path, read_checked(path) | {name: found})
        output.log(f"check {name}: {found.error or found.compared}")
    return failed
