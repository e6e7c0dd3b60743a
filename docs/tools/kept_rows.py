"""Pages of suites that take hours are made in parts: what runs at hand lack is kept as it was committed."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatproof.suites.suite_files import Case


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture of the page and what is seen there."""

    path: str
    """Relative to the page."""
    caption: str
    row: str = ""
    """Whose picture it is; empty: it shows several rows."""


def committed(path: Path) -> list[dict[str, Any]]:
    """Entries of a committed file; none where it is not there yet."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else []


def joined(
    new: Sequence[Mapping[str, Any]], old: Sequence[Mapping[str, Any]], cases: Sequence[Case]
) -> tuple[list[Mapping[str, Any]], int]:
    """Rows of runs, and those committed before of planned cases that were not run again; in the suite's order.

    A committed row is dropped where the suite's settings for it are others now, be it that the suite says so or
    that a default changed. Rows without settings (of before they were kept) and settings that a row knows nothing
    of are no reason.

    Args:
        new: Rows of the runs at hand.
        old: Rows that are committed.
        cases: What the suite plans.

    Returns: The rows, and how many of them are old.
    """
    rows, kept = [], 0
    by_case, before = ({_place(row): row for row in some} for some in (new, old))
    for case in cases:
        place = (case.scene_name, case.protocol.name, case.row, case.seed)
        if place in by_case:
            rows.append(by_case[place])
        elif place in before and not contradicts(before[place].get("settings", {}), plain(case)):
            rows.append(before[place])
            kept += 1
    return rows, kept


def plain(case: Case) -> dict[str, Any]:
    """A case's settings as JSON has them."""
    return json.loads(json.dumps(dataclasses.asdict(case.settings)))


def contradicts(old: Any, new: Any) -> bool:
    """Whether two settings differ in what both know.

    Args:
        old: A mapping, of mappings at any depth, or one value.
        new: The same.
    """
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        return any(contradicts(old[name], new[name]) for name in old.keys() & new.keys())
    return bool(old != new)


def pictures_of(
    new: Sequence[Picture], old: Sequence[Picture], rows: Sequence[Mapping[str, Any]]
) -> list[Picture]:
    """Pictures of before with those at hand in their places, and what is new at the end.

    Args:
        new: Pictures that were just made.
        old: Those that the page showed; one of a row that the page has no longer is left out.
        rows: Rows of the page.
    """
    there = {"", *(row["row"] for row in rows)}
    made = {picture.path: picture for picture in new}
    shown = [made.pop(one.path, one) for one in old if one.row in there]
    return [*shown, *made.values()]


def _place(row: Mapping[str, Any]) -> tuple[str, str, str, int]:
    return row["scene"], row["protocol"], row["row"], row["seed"]
