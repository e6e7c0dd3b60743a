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
    new: Sequence[Mapping[str, Any]],
    old: Sequence[Mapping[str, Any]],
    cases: Sequence[Case],
    earlier: Mapping[str, Any] | None = None,
) -> tuple[list[Mapping[str, Any]], int]:
    """Rows of runs, and those committed before of planned rows that were not run again; in the suite's order.

    A committed row is dropped where the suite's settings for it are others now, be it that the suite says so or
    that a default changed. Rows without settings (of before they were kept) and settings that a row knows nothing
    of are no reason. Seeds are no reason either: `--seeds` may have asked for more than the suite does.

    Args:
        new: Rows of the runs at hand.
        old: Rows that are committed.
        cases: What the suite plans.
        earlier: Defaults of before, by dotted names, that are no reason either: the page says what they cost.

    Returns: The rows, and how many of them are old.
    """
    planned = {(case.scene_name, case.protocol.name, case.row): plain(case) for case in cases}
    order = {place: number for number, place in enumerate(planned)}
    by_seed = {(_place(row), row["seed"]): row for row in new if _place(row) in order}
    kept = {
        (_place(row), row["seed"]): row for row in old
        if _place(row) in order and (_place(row), row["seed"]) not in by_seed
        and not contradicts(row.get("settings", {}), planned[_place(row)], earlier)
    }  # fmt: skip
    every = sorted((by_seed | kept).items(), key=lambda item: (order[item[0][0]], item[0][1]))
    return [row for _, row in every], len(kept)


def plain(case: Case) -> dict[str, Any]:
    """A case's settings as JSON has them."""
    return json.loads(json.dumps(dataclasses.asdict(case.settings)))


def contradicts(
    old: Any, new: Any, earlier: Mapping[str, Any] | None = None, name: str = ""
) -> bool:
    """Whether two settings differ in what both know.

    Args:
        old: A mapping, of mappings at any depth, or one value.
        new: The same.
        earlier: Values by dotted names that `old` may have, whatever `new` has.
        name: Dotted name of the two.
    """
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        return any(
            contradicts(old[key], new[key], earlier, f"{name}.{key}".lstrip("."))
            for key in old.keys() & new.keys()
        )
    return bool(old != new) and (earlier or {}).get(name, new) != old


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


def _place(row: Mapping[str, Any]) -> tuple[str, str, str]:
    return row["scene"], row["protocol"], row["row"]
