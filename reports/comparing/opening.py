"""What a user writes for a side: WHERE[@COMMIT][#ROW], and the side that it names."""

import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

from splatproof.base.errors import DataError, UsageError
from splatproof.base.names import did_you_mean
from splatproof.reports.comparing import baselines, sides
from splatproof.reports.comparing.sides import Side
from splatproof.reports.mlflow_client import shown_uri, sqlite_uri
from splatproof.reports.store import find_cases

COMMIT = re.compile(r"(?P<where>.+)@(?P<commit>[0-9a-f]{4,40}(-dirty)?)")
"""A place and a commit, of which at least four digits are given."""
STORE = "mlflow.db"
"""Name of the tracking store in a folder of runs."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """What a user wrote, in its parts."""

    where: str
    """A folder of runs, a store's file or URI, a baseline's file or name."""
    commit: str = ""
    """Start of a commit; empty: any, the newest result of each case."""
    row: str = ""
    """A row of tables, such as 3dgs@affine; empty: all."""


def parse(text: str) -> Spec:
    """The parts of WHERE[@COMMIT][#ROW].

    A row may itself have an "@", and stands behind "#"; so a commit is looked for before it. What exists
    as a file or folder is never taken apart.

    Args:
        text: What the user wrote.
    Raises: UsageError where the place or the row is empty.

    >>> parse("runs#3dgs@affine")
    Spec(where='runs', commit='', row='3dgs@affine')
    >>> parse("runs@0123abc")
    Spec(where='runs', commit='0123abc', row='')
    """
    if text and Path(text).exists():
        return Spec(where=text)
    where, mark, row = text.rpartition("#") if "#" in text else (text, "", "")
    if not where or (mark and not row):
        raise UsageError(
            f"{text!r}: expected WHERE[@COMMIT][#ROW], e.g. runs, runs#3dgs@affine or runs@0123abc"
        )
    found = None if Path(where).exists() else COMMIT.fullmatch(where)
    if found is None:
        return Spec(where=where, row=row)
    return Spec(where=found["where"], commit=found["commit"], row=row)


def open_side(text: str, *, folder: Path = baselines.FOLDER, suites: Collection[str] = ()) -> Side:
    """The side that a user names.

    WHERE is, in this order: a tracking URI (has "://"), a file NAME.db (an MLflow store) or NAME.json (a
    frozen baseline), a folder of runs, the name of a saved baseline. Of a folder the records on disk are
    read; where a commit is given, or where it has none, its mlflow.db, which keeps older results.

    Args:
        text: WHERE[@COMMIT][#ROW].
        folder: Where baselines are saved by name.
        suites: Suites that are kept; empty: all.
    Returns: A side with at least one case, called what the user wrote.
    Raises: UsageError for a name that is nothing; DataError for a damaged file or an empty side;
        MissingError for a store that does not answer.
    """
    spec = parse(text)
    label = shown_uri(text)
    side = sides.narrowed(_open(spec, label, folder), spec.row, suites)
    if not side.cases:
        raise DataError(f"{label}: no case; run a suite there first, e.g. `bench run quick`")
    return side


def _open(spec: Spec, label: str, folder: Path) -> Side:
    path = Path(spec.where)
    if "://" in spec.where:
        return sides.from_store(spec.where, label, spec.commit)
    if path.suffix == ".db" and path.is_file():
        return sides.from_store(sqlite_uri(path), label, spec.commit)
    if path.is_dir():
        store = path / STORE
        if store.is_file() and (spec.commit or not find_cases(path)):
            return sides.from_store(sqlite_uri(store), label, spec.commit)
        return _of_commit(sides.from_folder(path, label), spec)
    if path.suffix == ".json" and path.is_file():
        return _of_commit(baselines.read(path, label), spec)
    named = folder / f"{spec.where}.json"
    if named.is_file() and "/" not in spec.where:
        return _of_commit(baselines.read(named, label), spec)
    near = did_you_mean(spec.where, baselines.names(folder))
    raise UsageError(
        f"{spec.where}: no folder of runs, no store (.db file or URI), no baseline file; as the name of a "
        f"baseline in {folder}/ it is unknown{near}"
    )


def _of_commit(side: Side, spec: Spec) -> Side:
    found = sides.newest(side.label, sides.of_commit(side.cases, spec.commit, side.label))
    return replace(found, remarks=(*side.remarks, *found.remarks))
