"""The same row over commits: which versions of it were run, and what differs from one to the next."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from splatproof.reports.dashboard.summary import Summary
from splatproof.reports.dashboard.tables import digest

Series = tuple[str, str, str, str]
"""Suite, scene, row and protocol."""
WHAT = ("commit", "settings", "rules", "environment", "data")
"""What makes a version."""


@dataclass(frozen=True, kw_only=True)
class Version:
    """The runs of a row that differ in their seeds alone."""

    runs: tuple[Summary, ...]
    """The newest of each seed, by seed; failed ones are none."""

    @property
    def ended(self) -> int:
        """When its last run ended, in milliseconds since 1970 (UTC)."""
        return max(run.ended for run in self.runs)

    def of(self, what: str) -> str:
        """The commit, or the hash of anything else of WHAT."""
        first = self.runs[0]
        return first.numbers.data if what == "data" else getattr(first, what)

    def differs(self, before: "Version") -> list[str]:
        """What of WHAT is other than in another version."""
        return [what for what in WHAT if self.of(what) != before.of(what)]


def series_id(series: Series) -> str:
    """What the series is called in links."""
    return digest("series", *series)


def all_series(runs: Iterable[Summary]) -> dict[str, list[Summary]]:
    """Finished runs of each series by its `series_id`, from the oldest to the newest.

    Args:
        runs: From the oldest to the newest.
    """
    found: dict[str, list[Summary]] = {}
    for run in runs:
        if not run.numbers.error:
            found.setdefault(series_id(run.series), []).append(run)
    return found


def versions(runs: Sequence[Summary]) -> list[Version]:
    """The versions of one series, from the oldest to the newest.

    A version that was run again later, after another one, is one version: its runs are repetitions.

    Args:
        runs: Runs of one series, from the oldest to the newest.
    """

    def key(run: Summary) -> tuple[str, ...]:
        return run.commit, run.settings, run.rules, run.environment, run.numbers.data

    grouped = [list(own) for _, own in itertools.groupby(sorted(runs, key=key), key=key)]
    seeds = [
        {run.numbers.seed: run for run in sorted(own, key=lambda r: r.ended)} for own in grouped
    ]
    found = [Version(runs=tuple(own[seed] for seed in sorted(own))) for own in seeds]
    return sorted(found, key=lambda version: version.ended)
