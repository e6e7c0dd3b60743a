"""Where `bench claims` has its runs and checks from: committed rows, a folder of runs, a store."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import splatproof
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.base.files import read_json, write_text
from splatproof.reference.types.checked import Checked
from splatproof.reference.types.result import Result
from splatproof.reports.claims.claim import CheckClaim, Claim
from splatproof.reports.claims.obstacles import Known
from splatproof.reports.findings.finding import Finding, findings
from splatproof.reports.measured import Measured, measured, measured_row

CHECKS_NAME = "claims_checks.json"
"""File of measured checks, beside the page and in a folder of runs."""
QUICK = "-quick"
"""How the reduced form of a suite is called."""


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What claims are judged by."""

    runs: Mapping[str, Sequence[Measured]] = field(default_factory=dict)
    """All cases of each suite."""
    checked: Mapping[str, Checked] = field(default_factory=dict)
    """What checks measured, by their names."""

    @property
    def machines(self) -> list[str]:
        """Where it was measured."""
        cases = [run.machine for own in self.runs.values() for run in own]
        return sorted(
            {name for name in (*cases, *(c.machine for c in self.checked.values())) if name}
        )


def known(suites: Iterable[str]) -> Known:
    """The methods of this installation, and the cases of suites.

    Args:
        suites: Names of the suites, and of those whose reduced forms are meant too; a name that no suite
            has is left out.
    """
    from splatproof.methods.registry import methods
    from splatproof.suites.suite_files import load_suite, suite_names

    existing = suite_names()
    return Known(
        methods=frozenset(methods()),
        suites={
            name: frozenset(
                (case.scene_name, case.protocol.name, case.row) for case in load_suite(name).cases
            )
            for name in _with_forms(suites)
            if name in existing
        },
    )


def _with_forms(suites: Iterable[str]) -> list[str]:
    """Each name and that of its reduced form."""
    return [form for name in dict.fromkeys(suites) for form in (name, f"{name}{QUICK}")]


def judged(
    claims: Sequence[Claim], checks: Sequence[CheckClaim], evidence: Evidence
) -> list[Finding]:
    """Every claim with what the evidence says of it.

    Args:
        claims: Claims about rows of suites.
        checks: Claims that checks measure.
        evidence: Runs and checks.
    """
    return findings(
        claims, checks, evidence.runs, evidence.checked, known(one.suite for one in claims)
    )


def docs_folder() -> Path:
    """The docs folder of the checkout that this package runs from.

    Raises: MissingError for an installed package, which has none.
    """
    folder = Path(splatproof.__file__).parents[2] / "docs"
    if not (folder / CHECKS_NAME).is_file():
        raise MissingError(
            "no committed rows: an installed package has no docs folder; judge runs of your own with "
            "`bench claims --run`, or --runs FOLDER"
        )
    return folder


def committed(folder: Path, suites: Iterable[str]) -> Evidence:
    """The rows behind the suites' pages, and the checks.

    Args:
        folder: Holds SUITE.json and claims_checks.json; what is not there has not been run.
        suites: Names of the suites.
    Raises: DataError for a damaged file.
    """
    runs = {
        name: [measured_row(row) for row in _listing(folder / f"{name}.json")]
        for name in dict.fromkeys(suites)
        if (folder / f"{name}.json").is_file()
    }
    return Evidence(runs=runs, checked=read_checked(folder / CHECKS_NAME))


def of_runs(place: str | Path, suites: Iterable[str], *, quick: bool = False) -> Evidence:
    """The records below a folder of runs, or those of a tracking store.

    Args:
        place: What `bench run` calls OUT, or a tracking URI ("sqlite:///runs/mlflow.db").
        suites: Names of the suites.
        quick: Take the runs of each suite's reduced form instead.
    Raises: UsageError where there is no such folder or store.
    """
    names = {name: f"{name}{QUICK}" if quick else name for name in dict.fromkeys(suites)}
    if isinstance(place, str) and "://" in place:
        from splatproof.reports.mlflow_client import check_uri
        from splatproof.reports.store import read_results

        check_uri(place)
        results = [stored.result for stored in read_results(place)]
        return Evidence(runs={name: _of_suite(results, own) for name, own in names.items()})
    from splatproof.suites.records import read_ended

    folder = Path(place)
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; expected what `bench run` calls OUT, or a URI")
    return Evidence(
        runs={name: [*map(measured, read_ended(folder / own))] for name, own in names.items()},
        checked=read_checked(folder / CHECKS_NAME),
    )


def _of_suite(results: Sequence[Result], name: str) -> list[Measured]:
    return [measured(result) for result in results if result.suite == name]


def in_quick_form(claims: Iterable[Claim], suites: Mapping[str, frozenset]) -> list[Claim]:
    """The claims as the reduced forms of their suites can speak of them.

    Reduced forms may run under a protocol of their own, or on another scene.

    Args:
        claims: Claims about whole suites.
        suites: Cases (scene, protocol, row) of every suite.
    """
    found = []
    for claim in claims:
        cases = suites.get(f"{claim.suite}{QUICK}", frozenset())
        there = {protocol for _, protocol, _ in cases}
        found.append(
            replace(claim, scenes=(), protocol=claim.protocol if claim.protocol in there else "")
        )
    return found


def read_checked(path: Path) -> dict[str, Checked]:
    """Measured checks by name; none where there is no file. Raises: DataError for a damaged one."""
    found = {}
    for row in _listing(path) if path.is_file() else ():
        try:
            told: dict[str, Any] = {**row, "values": tuple(map(float, row["values"]))}
            one = Checked(**told)
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"{path}: not a measured check ({error}): {str(row)[:80]}") from None
        found[one.check] = one
    return found


def write_checked(path: Path, checked: Mapping[str, Checked]) -> None:
    """Write measured checks, one a line.

    Args:
        path: JSON file to write.
        checked: What was measured, by name.
    """
    lines = ",\n".join(json.dumps(asdict(one), ensure_ascii=False) for one in checked.values())
    write_text(path, f"[\n{lines}\n]\n")


def _listing(path: Path) -> list[dict[str, Any]]:
    found = read_json(path)
    if not isinstance(found, list) or not all(isinstance(row, dict) for row in found):
        raise DataError(f"{path}: expected a list of rows")
    return found
