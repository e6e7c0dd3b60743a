"""The history of a row as the page shows it: versions, their values, what changed, change points."""

from collections.abc import Callable, Sequence
from typing import Any

from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.differing import differing
from splatproof.reports.comparing.matching import Group
from splatproof.reports.dashboard.changes import RULE, changes
from splatproof.reports.dashboard.history import Version, versions
from splatproof.reports.dashboard.numbers import short
from splatproof.reports.dashboard.sides import version_side
from splatproof.reports.dashboard.summary import Summary
from splatproof.reports.statistics import summarise

CaseOf = Callable[[str], CaseRecord]
"""Reads what a comparison needs of a run by its name."""


def history_payload(runs: Sequence[Summary], case_of: CaseOf) -> dict[str, Any]:
    """A row's versions, and its change points in every metric that is judged.

    Args:
        runs: Runs of one series, from the oldest to the newest.
        case_of: See `CaseOf`.
    """
    found = versions(runs)
    cases = [[case_of(run.run) for run in version.runs] for version in found]
    judged = changes(cases)
    others = sorted({name for run in runs for name in run.numbers.values} - judged.keys())
    return {
        "metrics": [*judged, *others],
        "rule": RULE,
        "versions": [_version(found, cases, place) for place in range(len(found))],
        "changes": {
            metric: [
                {"at": one.at, "verdict": one.verdict, "reason": one.reason,
                 "mean": short(one.mean), "low": short(one.low), "high": short(one.high),
                 "relative": one.relative}
                for one in own
            ]
            for metric, own in judged.items()
        },
    }  # fmt: skip


def _version(
    found: Sequence[Version], cases: Sequence[Sequence[CaseRecord]], place: int
) -> dict[str, Any]:
    version = found[place]
    changed: list[list[Any]] = []
    if place:
        same = version.runs[0].numbers
        group = Group(
            suite=version.runs[0].suite, scene=same.scene, protocol=same.protocol, row=same.row,
            base=tuple(cases[place - 1]), new=tuple(cases[place]),
        )  # fmt: skip
        details = differing([group])
        for kind in dict.fromkeys(
            [*(one.kind for one in details), *version.differs(found[place - 1])]
        ):
            kind = "protocol" if kind == "rules" else kind
            own = [[d.name, d.base, d.new] for d in details if d.kind == kind]
            if [kind, own] not in changed:
                changed.append([kind, own])
    names = sorted({name for run in version.runs for name in run.numbers.values})
    return {
        "commit": version.of("commit"),
        "side": version_side(version),
        "ended": version.ended,
        "runs": [run.run for run in version.runs],
        "values": {name: _cell(version, name) for name in names},
        "changed": changed,
    }


def _cell(version: Version, name: str) -> list[Any]:
    values = [run.numbers.values[name] for run in version.runs if name in run.numbers.values]
    summary = summarise(values)
    return [short(summary.mean), short(summary.low), short(summary.high)]
