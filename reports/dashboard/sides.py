"""What can be compared: a row over all scenes of its suite, or one row at one commit."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

from splatproof.reports.dashboard.history import Version, all_series, versions
from splatproof.reports.dashboard.index import Index
from splatproof.reports.dashboard.summary import Summary
from splatproof.reports.dashboard.tables import digest, row_side


@dataclass(frozen=True, kw_only=True)
class Side:
    """Runs that are compared with others as a whole."""

    id: str
    """What links call it."""
    kind: Literal["row", "version"]
    suite: str
    protocol: str
    rules: str
    """Hash of the protocol's rules."""
    label: str
    """What tables call the row; of a version the row's own name."""
    commit: str
    """Of a version; empty for a row."""
    runs: tuple[Summary, ...]
    """Finished runs, by scene and seed."""

    def plain(self) -> dict[str, Any]:
        """What the page needs for choosing it."""
        return {
            "id": self.id, "kind": self.kind, "suite": self.suite, "protocol": self.protocol,
            "rules": self.rules, "label": self.label, "commit": self.commit,
        }  # fmt: skip


def version_side(version: Version) -> str:
    """What a version, over all scenes that were run at it, is called in links."""
    first = version.runs[0]
    return digest("version", first.suite, first.numbers.row, first.numbers.protocol,
                  *(version.of(what) for what in ("commit", "settings", "rules", "environment")))  # fmt: skip


def all_sides(index: Index) -> dict[str, Side]:
    """Everything that can be compared, by its id: rows of the leaderboards, then versions.

    Rows that were run at one version only have no sides of versions: they would be the same.
    """
    by_run = {one.run: one for one in index.runs}
    found: dict[str, Side] = {}
    for table in index.tables:
        brief = table["brief"]
        if not brief["scene"]:
            continue  # its rows stand in the tables of the scenes
        for row in brief["rows"]:
            where = (brief["suite"], brief["protocol"], brief["rules"])
            _add(found, Side(
                id=row_side(*where, row["label"]), kind="row", label=row["label"], commit="",
                suite=where[0], protocol=where[1], rules=where[2],
                runs=tuple(by_run[run] for run in row["runs"]),
            ))  # fmt: skip
    for series in all_series(index.runs).values():
        own = versions(series)
        for version in own if len(own) > 1 else ():
            first = version.runs[0]
            _add(found, Side(
                id=version_side(version), kind="version", label=first.numbers.row,
                suite=first.suite, protocol=first.numbers.protocol, rules=first.rules,
                commit=first.commit, runs=version.runs,
            ))  # fmt: skip
    return found


def _add(found: dict[str, Side], side: Side) -> None:
    """Add a side, or its runs to those of the same side on other scenes."""
    before = found[side.id].runs if side.id in found else ()
    runs = {one.run: one for one in (*before, *side.runs)}.values()
    if not runs:
        return
    found[side.id] = replace(side, runs=tuple(sorted(runs, key=_place)))


def _place(one: Summary) -> tuple[str, int, int]:
    return one.numbers.scene, one.numbers.seed, one.ended


def comparable_pairs(sides: Iterable[Side]) -> list[tuple[Side, Side]]:
    """Pairs of rows of one suite under the same rules, each pair both ways round."""
    rows = [side for side in sides if side.kind == "row"]
    return [
        (one, other) for one in rows for other in rows
        if one is not other
        and (one.suite, one.protocol, one.rules) == (other.suite, other.protocol, other.rules)
    ]  # fmt: skip
