"""The whole store as the dashboard knows it, brought up to date by reading what is new."""

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from splatproof.reference.types.result import Result
from splatproof.reports.dashboard.cache import Cache
from splatproof.reports.dashboard.listing import list_runs
from splatproof.reports.dashboard.summary import (
    Summary,
    from_plain,
    newest,
    summarised,
    to_plain,
)
from splatproof.reports.dashboard.tables import digest, plain_tables
from splatproof.reports.store import read_run

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and of how much."""
BATCH = 200
"""Runs after which the cache is written: what a stopped start loses at most."""


def silent(doing: str, done: int, total: int) -> None:
    """Tell nobody.

    Args:
        doing: What is being done.
        done: How much of it is done.
        total: Of how much.
    """


@dataclass(frozen=True, kw_only=True)
class Index:
    """All finished runs of a store, and the leaderboards of the newest of each case."""

    runs: tuple[Summary, ...]
    """From the oldest to the newest."""
    shown: tuple[Summary, ...]
    """The newest run of every case, sorted by suite, scene, row, protocol and seed."""
    tables: tuple[dict[str, Any], ...]
    """The leaderboards, see `tables.plain_tables`."""


def refreshed(uri: str, cache: Cache, progress: Progress = silent) -> Index:
    """The store as it is now.

    Runs that the cache knows are not read again, and a leaderboard is computed again only where its runs
    are others.

    Args:
        uri: Tracking URI.
        cache: What was read before; kept up to date.
        progress: Told of what takes long.
    Raises:
        MissingError: The store does not answer, or the files of a run are gone.
        DataError: A record in the store is damaged.
    """
    runs, fresh = _runs(uri, cache, progress)
    shown = newest(runs)
    tables, groups = [], itertools.groupby(
        sorted(shown, key=lambda one: (one.suite, one.numbers.protocol)),
        key=lambda one: (one.suite, one.numbers.protocol),
    )  # fmt: skip
    done = 0
    for (suite, protocol), group in groups:
        own = list(group)
        progress("leaderboards", done, len(shown))
        tables += _tables(f"tables {suite} {protocol}", own, uri, cache, fresh)
        done += len(own)
    return Index(runs=tuple(runs), shown=tuple(shown), tables=tuple(tables))


def _runs(uri: str, cache: Cache, progress: Progress) -> tuple[list[Summary], dict[str, Result]]:
    """Every run, and the records of those that were read now."""
    kept, listed = cache.runs(), list_runs(uri)
    runs, fresh, unkept = [], {}, []
    new = sum(one.run not in kept for one in listed)
    for one in listed:
        if one.run in kept:
            runs.append(from_plain(json.loads(kept[one.run])))
            continue
        result = read_run(uri, one.run, one.files)
        fresh[one.run] = result
        runs.append(summarised(one, result))
        unkept.append((one.run, to_plain(runs[-1])))
        if len(unkept) == BATCH:
            progress("records", len(fresh), new)
            cache.keep_runs(unkept)
            unkept = []
    cache.keep_runs(unkept)
    return runs, fresh


def _tables(
    name: str, own: Sequence[Summary], uri: str, cache: Cache, fresh: Mapping[str, Result]
) -> list[dict[str, Any]]:
    """The tables of one suite and protocol, from the cache where they are of these runs."""
    made_of = digest([one.run for one in own])
    found = cache.derived(name, made_of)
    if found is None:
        results = [fresh.get(s.run) or read_run(uri, s.run, s.files) for s in own]
        found = plain_tables(results, {one.case: one.run for one in own})
        cache.keep_derived(name, made_of, found)
    return found
