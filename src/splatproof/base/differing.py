"""What differs between two sets of named values, in words: "density.start 500 before, 700 now"."""

import json
from collections.abc import Iterator, Mapping

SHOWN = 3
"""Differences that are named; of more, their number is."""
LONGEST = 40
"""Characters of a value that are shown."""


def differences(before: Mapping[str, object], now: Mapping[str, object]) -> str:
    """The values that differ, with dots between the names of nested ones.

    Args:
        before: Plain data by name, as JSON holds it; nested mappings are looked into.
        now: The same of today. Tuples and lists are the same.
    Returns: Up to SHOWN differences with commas between them; empty where there are none.

    >>> differences({"a": 1, "b": {"c": 2}}, {"a": 1, "b": {"c": 3}, "d": None})
    'b.c 2 before, 3 now; d not there before, null now'
    """
    old, new = dict(_flat(before)), dict(_flat(now))
    names = [name for name in (*old, *(new.keys() - old.keys())) if old.get(name) != new.get(name)]
    told = [f"{n} {_cut(old.get(n))} before, {_cut(new.get(n))} now" for n in names[:SHOWN]]
    more = [f"and {len(names) - SHOWN} more"] if len(names) > SHOWN else []
    return "; ".join([*told, *more])


def _cut(value: str | None) -> str:
    if value is None:
        return "not there"
    return value if len(value) <= LONGEST else f"{value[:LONGEST]}…"


def _flat(values: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", json.dumps(value, default=str)
