"""What the dashboard keeps of a run: its numbers and where they are from, small enough for ten thousand."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from splatproof.reference.types.result import MOMENTS, Result
from splatproof.reports import run_data
from splatproof.reports.dashboard.listing import Listed
from splatproof.reports.measured import Measured, measured


@dataclass(frozen=True, kw_only=True)
class Summary:
    """A finished run of the store in numbers."""

    run: str
    """MLflow's name of it."""
    files: str
    """Where its files are, as MLflow tells it."""
    ended: int
    """Milliseconds since 1970 (UTC)."""
    suite: str
    case: str
    """Hash of name, settings and rules: the newest run of a case stands in the leaderboard."""
    settings: str
    """Hash of the method's settings."""
    rules: str
    """Hash of the protocol's rules."""
    commit: str
    """Git commit that it was run from; empty where the record does not say."""
    environment: str
    """Hash of the environment without the commit and what differs from run to run."""
    numbers: Measured

    @property
    def series(self) -> tuple[str, str, str, str]:
        """Suite, scene, row and protocol: what stays the same from commit to commit."""
        own = self.numbers
        return self.suite, own.scene, own.row, own.protocol


def summarised(listed: Listed, result: Result) -> Summary:
    """The summary of a run.

    Args:
        listed: The run as the store lists it.
        result: Its record.
    """
    elsewhere = {k: v for k, v in result.environment.items() if k not in ("commit", *MOMENTS)}
    return Summary(
        run=listed.run,
        files=listed.files,
        ended=listed.ended,
        suite=result.suite,
        case=run_data.case_key(result),
        settings=run_data.digest(result.settings),
        rules=run_data.digest(result.protocol_rules),
        commit=result.environment.get("commit", ""),
        environment=run_data.digest(elsewhere),
        numbers=measured(result),
    )


def to_plain(summary: Summary) -> dict[str, Any]:
    """The summary as plain data for JSON."""
    return dataclasses.asdict(summary)


def from_plain(plain: Mapping[str, Any]) -> Summary:
    """The summary that `to_plain` made."""
    own: dict[str, Any] = {**plain, "numbers": Measured(**plain["numbers"])}
    return Summary(**own)


def newest(summaries: list[Summary]) -> list[Summary]:
    """The newest run of every case, as `store.read_results` chooses it.

    Args:
        summaries: From the oldest to the newest.
    Returns: Sorted by suite, scene, row, protocol, seed and case.
    """
    last = {one.case: one for one in summaries}
    return sorted(last.values(), key=lambda one: (*one.series, one.numbers.seed, one.case))
