"""One side of a comparison: cases from a folder of runs, a tracking store or a frozen baseline."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from splatproof.base.errors import UsageError
from splatproof.base.files import read_bytes, read_text
from splatproof.base.names import unknown
from splatproof.reference.types.result import Result, picture_name
from splatproof.reference.types.result_json import result_from_json
from splatproof.reports.comparing.cases import CaseRecord, case_record
from splatproof.reports.store import FOLDERS, Picture, StoredResult, find_cases, read_history

COMMIT_SHOWN = 10
"""Digits of a commit that people are shown."""
RECORD = "record.json"
DIRTY = "-dirty"
"""End of the commit of a checkout whose files differed from it."""


@dataclass(frozen=True, kw_only=True)
class Side:
    """What is compared with what: cases, and what people call them together."""

    label: str
    cases: tuple[CaseRecord, ...]
    """At most one of each name (suite, scene, row, protocol, seed)."""
    remarks: tuple[str, ...] = ()
    """What was left out of where the cases come from."""


def side_of(label: str, results: Iterable[Result | StoredResult]) -> Side:
    """A side of results, of which the last of each case counts.

    Args:
        label: What people call it.
        results: Results from the oldest to the newest, from `read_history`, or as records hold them.
    """
    records = [
        case_record(one.result, one.picture) if isinstance(one, StoredResult) else case_record(one)
        for one in results
    ]
    return newest(label, records)


def newest(label: str, records: Iterable[CaseRecord]) -> Side:
    """A side with the last record of each case.

    Args:
        label: What people call it.
        records: From the oldest to the newest.
    """
    kept: dict[str, CaseRecord] = {}
    several: dict[str, None] = {}
    for record in records:
        before = kept.get(record.name)
        if before and (before.settings, before.rules) != (record.settings, record.rules):
            several[record.name] = None
        kept[record.name] = record
    remarks: tuple[str, ...] = ()
    if several:
        more = f" and {len(several) - 1} more" if len(several) > 1 else ""
        remarks = (
            f"{label}: of several settings of {next(iter(several))}{more} the newest counts",
        )
    return Side(label=label, cases=tuple(kept[name] for name in sorted(kept)), remarks=remarks)


def from_folder(folder: Path, label: str) -> Side:
    """The records of all cases below a folder of runs; of a case that lies there several times the newest.

    Args:
        folder: What `bench run` calls OUT, or a folder below or above.
        label: What people call the side.
    Raises: DataError naming a record that is damaged.
    """
    places: dict[str, list[Path]] = {}
    records = []
    for case in sorted(find_cases(folder), key=lambda one: (one / RECORD).stat().st_mtime):
        path = case / RECORD
        result = result_from_json(read_text(path), str(path))
        records.append(case_record(result, PicturesOnDisk(case)))
        places.setdefault(records[-1].name, []).append(case)
    side = newest(label, records)
    several = [name for name, own in places.items() if len(own) > 1]
    if not several:
        return side
    more = f" and {len(several) - 1} more" if len(several) > 1 else ""
    told = f"{label}: {several[0]}{more} in several folders; the newest counts, {places[several[0]][-1]}"
    return replace(side, remarks=(*side.remarks, told))


@dataclass(frozen=True)
class PicturesOnDisk:
    """Pictures of a case folder."""

    folder: Path

    def __call__(self, kind: Picture, image: str) -> bytes | None:
        """The PNG of a test image; None where there is none.

        Args:
            kind: Its render, its truth or its error map.
            image: Name of the view.
        """
        path = self.folder / FOLDERS[kind] / picture_name(image)
        return read_bytes(path) if path.is_file() else None


def from_store(uri: str, label: str, commit: str = "") -> Side:
    """The newest result of each case in a tracking store.

    Args:
        uri: Tracking URI.
        label: What people call the side.
        commit: Start of the commit that results are of; empty: of any.
    Raises: UsageError where no result is of that commit; see `read_history`.
    """
    side_cases = [case_record(one.result, one.picture) for one in read_history(uri)]
    return newest(label, of_commit(side_cases, commit, label))


def of_commit(cases: Iterable[CaseRecord], commit: str, where: str) -> list[CaseRecord]:
    """The cases of a commit; those of a checkout with changed files only where that is asked for.

    Args:
        cases: Cases of any commits.
        commit: Start of its name, with -dirty for changed files; empty: all cases.
        where: What the cases are from, for errors.
    Raises: UsageError where there is none, or where the start fits several.
    """
    cases = list(cases)
    named = sorted({case.commit for case in cases if case.commit})
    fitting = [name for name in named if name.startswith(commit.removesuffix(DIRTY))]
    dirty = commit.endswith(DIRTY)
    chosen = [n for n in fitting if n.endswith(DIRTY) == dirty] or ([] if dirty else fitting)
    if not commit:
        return cases
    if not chosen:
        raise unknown(f"commit of {where}", commit, map(short_commit, named))
    if len(chosen) > 1:
        told = ", ".join(map(short_commit, chosen))
        raise UsageError(
            f"{where}: commit {commit!r} may be any of {told}; give more of its digits"
        )
    return [case for case in cases if case.commit == chosen[0]]


def short_commit(name: str) -> str:
    """A commit as people read it: COMMIT_SHOWN digits, and -dirty where it ends so.

    Args:
        name: The whole name.
    """
    return name.removesuffix(DIRTY)[:COMMIT_SHOWN] + (DIRTY if name.endswith(DIRTY) else "")


def narrowed(side: Side, row: str = "", suites: Collection[str] = ()) -> Side:
    """The side with the cases of one row, or of some suites, alone.

    Args:
        side: Any side.
        row: Name of the row, as tables show it; empty: all rows.
        suites: Names of suites; empty: all suites.
    Raises: UsageError for a row or suite that the side does not have.
    """
    cases = side.cases
    for suite in suites:
        if all(case.suite != suite for case in side.cases):
            raise unknown(f"suite of {side.label}", suite, {case.suite for case in side.cases})
    cases = tuple(case for case in cases if not suites or case.suite in suites)
    if row and all(case.measured.row != row for case in cases):
        raise unknown(f"row of {side.label}", row, {case.measured.row for case in cases})
    cases = tuple(case for case in cases if not row or case.measured.row == row)
    return replace(side, cases=cases)
