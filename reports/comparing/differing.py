"""What of two sides differed besides their numbers: commit, settings, data, environment."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from splatproof.reference.types.result import MOMENTS
from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.matching import Group
from splatproof.reports.comparing.sides import short_commit

Kind = Literal["commit", "settings", "data", "environment", "protocol"]
NONE = "(none)"
"""Shown where a side has no such value."""
MOST = 3
"""Number of different values of one side that are shown."""


@dataclass(frozen=True, kw_only=True)
class Differing:
    """One thing that is not the same on both sides."""

    kind: Kind
    name: str
    """Dotted name of the setting, hash, version or rule."""
    base: str
    """Its value; several, with commas between them, where the side's cases differ among themselves."""
    new: str
    where: str
    """Names of the groups that it holds for: "everywhere", or some of them."""


def differing(groups: Sequence[Group]) -> list[Differing]:
    """Everything that compared cases were made of and that is not the same on both sides.

    Args:
        groups: Groups that are compared.
    Returns: Commit first, then settings, data, rules and environment by name; each once, with the
        groups that it holds for.
    """
    reads: list[tuple[Kind, Callable[[CaseRecord], dict[str, object]]]] = [
        ("commit", lambda case: {"commit": short_commit(case.commit)}),
        ("settings", lambda case: case.settings),
        ("data", lambda case: dict(case.data)),
        ("protocol", lambda case: case.rules),
        ("environment", _environment),
    ]
    found: dict[tuple[Kind, str, str, str], list[str]] = {}
    for kind, read in reads:
        for group in groups:
            base, new = ([read(case) for case in side] for side in (group.base, group.new))
            names = sorted({name for values in (*base, *new) for name in values})
            for name in names:
                one, other = _values(base, name), _values(new, name)
                if one != other:
                    found.setdefault((kind, name, one, other), []).append(group.name)
    return [
        Differing(kind=kind, name=name, base=one, new=other, where=_where(places, len(groups)))
        for (kind, name, one, other), places in found.items()
    ]


def _environment(case: CaseRecord) -> dict[str, object]:
    """Environment without what is told elsewhere or differs from run to run."""
    return {k: v for k, v in case.environment.items() if k not in ("commit", *MOMENTS)}


def _values(side: Sequence[dict[str, object]], name: str) -> str:
    values = sorted({str(own[name]) if name in own else NONE for own in side})
    more = f", and {len(values) - MOST} more" if len(values) > MOST else ""
    return ", ".join(values[:MOST]) + more


def _where(places: Sequence[str], groups: int) -> str:
    if len(places) == groups:
        return "everywhere"
    more = f" and {len(places) - 1} more" if len(places) > 1 else ""
    return places[0] + more
