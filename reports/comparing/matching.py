"""Which cases of two sides are compared with which, and why others are not."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields

from splatproof.reference.types.protocol import Protocol
from splatproof.reports.comparing.cases import CaseRecord, plain

SCORING_ADDS = ("name", "source", "metrics", "parts", "colour_fit")
"""Rules of a protocol that change no score, but which scores there are and what it is called."""
USUAL = {rule.name: plain(rule.default) for rule in fields(Protocol) if rule.default is not MISSING}
"""What a rule is that a record does not name, since it was made before there was that rule."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """The seeds of one row on one scene, on both sides."""

    suite: str
    scene: str
    protocol: str
    row: str
    """Name of the row; "a -> b" where two rows are compared."""
    base: tuple[CaseRecord, ...]
    """Finished cases by seed."""
    new: tuple[CaseRecord, ...]

    @property
    def name(self) -> str:
        """suite/scene/row/protocol, for people."""
        return f"{self.suite}/{self.scene}/{self.row}/{self.protocol}"


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A case that fails on one side and not on the other."""

    case: str
    """suite/scene/row/protocol/seed0"""
    on: str
    """BASE: it failed there and finishes now; NEW: it finished and fails now."""
    error: str


@dataclass(frozen=True, kw_only=True)
class NotComparable:
    """What of the two sides is not compared, and why."""

    what: str
    """Name of cases, or of a metric of them."""
    why: str
    lacking: str = ""
    """BASE or NEW: the side that lacks what the other has; empty where both have it, or neither."""
    otherwise: bool = False
    """Both sides have it, scored by other rules or on other views or pixels."""


@dataclass(frozen=True, kw_only=True)
class Matched:
    """Everything of two sides, each case in one place."""

    groups: tuple[Group, ...]
    failures: tuple[Failure, ...]
    not_comparable: tuple[NotComparable, ...]


def match(base: Sequence[CaseRecord], new: Sequence[CaseRecord]) -> Matched:
    """Pair the cases of two sides by suite, scene, protocol, row and seed.

    Where either side has one row and they have other names, these two rows are compared. A group is
    compared where all its cases have the same rules of scoring, training views, scored images and truth
    pixels; what keeps it from that, and every case that only one side has, is said by name.

    Args:
        base: Cases of the side that is compared with.
        new: Cases of the side that is judged.
    """
    rename = _one_row_each(base, new)
    sides = _by_group(base, rename), _by_group(new, rename)
    groups: list[Group] = []
    failures: list[Failure] = []
    faults: list[NotComparable] = []
    for key in sorted(sides[0].keys() | sides[1].keys()):
        suite, scene, protocol, row = key
        ours, theirs = (side.get(key, {}) for side in sides)
        name = f"{suite}/{scene}/{row}/{protocol}"
        if not ours or not theirs:
            missing = "BASE" if not ours else "NEW"
            why = f"missing on {missing}{_failing(ours or theirs)}"
            faults.append(NotComparable(what=name, why=why, lacking=missing))
            continue
        failures += _failures(name, ours, theirs)
        faults += _one_sided(name, ours, theirs)
        done = [
            tuple(own[seed] for seed in sorted(own) if not own[seed].measured.error)
            for own in (ours, theirs)
        ]
        group = Group(
            suite=suite, scene=scene, protocol=protocol, row=row, base=done[0], new=done[1]
        )
        if not done[0] or not done[1]:
            side = " and ".join(w for w, own in zip(("BASE", "NEW"), done, strict=True) if not own)
            faults.append(NotComparable(what=name, why=f"no finished case on {side}"))
        elif why := _fault(group):
            faults.append(NotComparable(what=name, why=why, otherwise=True))
        else:
            groups.append(group)
    return Matched(groups=tuple(groups), failures=tuple(failures), not_comparable=tuple(faults))


def _one_row_each(base: Sequence[CaseRecord], new: Sequence[CaseRecord]) -> str:
    """What the only rows of two sides are called together, where they have other names; else empty."""
    rows = [{case.measured.row for case in side} for side in (base, new)]
    if len(rows[0]) == len(rows[1]) == 1 and rows[0] != rows[1]:
        return f"{rows[0].pop()} -> {rows[1].pop()}"
    return ""


def _by_group(
    side: Sequence[CaseRecord], rename: str
) -> dict[tuple[str, str, str, str], dict[int, CaseRecord]]:
    found: dict[tuple[str, str, str, str], dict[int, CaseRecord]] = defaultdict(dict)
    for case in side:
        suite, scene, protocol, row = case.group
        found[suite, scene, protocol, rename or row][case.measured.seed] = case
    return found


def _failures(name: str, base: dict[int, CaseRecord], new: dict[int, CaseRecord]) -> list[Failure]:
    found = []
    for seed in sorted(base.keys() & new.keys()):
        before, after = base[seed].measured.error, new[seed].measured.error
        if bool(before) != bool(after):
            on = "BASE" if before else "NEW"
            found.append(Failure(case=f"{name}/seed{seed}", on=on, error=before or after))
    return found


def _failing(cases: dict[int, CaseRecord]) -> str:
    """ "; fails: ..." with the first error of what one side alone has."""
    errors = [case.measured.error for case in cases.values() if case.measured.error]
    return f"; fails: {errors[0]}" if errors else ""


def _one_sided(
    name: str, base: dict[int, CaseRecord], new: dict[int, CaseRecord]
) -> list[NotComparable]:
    """Seeds that only one side has, or that failed on both."""
    sides = {seed: "NEW" if seed in base else "BASE" for seed in sorted(base.keys() ^ new.keys())}
    found = [
        NotComparable(
            what=f"{name}/seed{seed}",
            why=f"missing on {side}{_failing({seed: (base if side == 'NEW' else new)[seed]})}",
            lacking=side,
        )
        for seed, side in sides.items()
    ]
    return found + [
        NotComparable(what=f"{name}/seed{seed}", why=f"failed on both: {new[seed].measured.error}")
        for seed in sorted(base.keys() & new.keys())
        if base[seed].measured.error and new[seed].measured.error
    ]


def _fault(group: Group) -> str:
    """Why the cases of a group must not be compared; empty where they may be."""
    one = group.base[0]
    for other in (*group.base[1:], *group.new):
        ours, theirs = USUAL | one.rules, USUAL | other.rules
        rules = [
            name for name in sorted(ours.keys() | theirs.keys())
            if name.split(".")[0] not in SCORING_ADDS and ours.get(name) != theirs.get(name)
        ]  # fmt: skip
        pair = f"({_place(group, one)} and {_place(group, other)})"
        if rules:
            told = ", ".join(f"{n} {ours.get(n)!r}, {theirs.get(n)!r}" for n in rules)
            return f"other rules of the protocol: {told} {pair}"
        if one.split != other.split:
            return f"other training or test views {pair}"
        if odd := sorted(one.truth.keys() ^ other.truth.keys()):
            return f"other scored images, e.g. {odd[0]} {pair}"
        if odd := sorted(name for name, sha in one.truth.items() if other.truth[name] != sha):
            return (
                f"other truth pixels in {len(odd)} of {len(one.truth)} images, e.g. {odd[0]} {pair}"
            )
    return ""


def _place(group: Group, case: CaseRecord) -> str:
    side = "BASE" if any(case is own for own in group.base) else "NEW"
    return f"{side} seed {case.measured.seed}"
