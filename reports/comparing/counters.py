"""Counters of work compared: exactly, where the same code would have given the same numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.matching import Group

SAME_BITS = ("simd", "backend", "torch", "numpy")
"""Parts of the environment that must agree for the same code to give the same bits."""
WORK = {"pairs": 0.1, "render_pairs": 0.1}
"""Counters of which more is worse, and the share by which they may grow. Other counters say that
something changed, and not whether for better or worse. On tests/regression pairs scatter by 3.3 % from seed
to seed, so by 1.9 % in the sum of three seeds, and any change of bits is like another seed."""
Verdict = Literal["same", "changed", "worse", "not compared"]


@dataclass(frozen=True, kw_only=True)
class Counted:
    """One counter of a group on both sides."""

    group: Group
    counter: str
    verdict: Verdict
    base: int
    """Sum over the seeds that both sides have."""
    new: int
    reason: str
    """Why this verdict, in one line."""


def counted(groups: Sequence[Group]) -> list[Counted]:
    """Every counter that both sides of a group have.

    *same*: each seed that both sides have has the very same number. Where not: *not compared* if the sides
    were computed differently (see SAME_BITS) or have no seed in common, *worse* if the sum over those seeds
    grew by more than the counter's share in WORK, else *changed*.

    Args:
        groups: Groups that are compared.
    Source: ours.
    """
    return [
        _counted(group, name)
        for group in groups
        for name in sorted(_names(group.base) & _names(group.new))
    ]


def _names(side: Sequence[CaseRecord]) -> set[str]:
    """Counters that all cases of a side have."""
    names = [set(case.measured.counters) for case in side]
    return set.intersection(*names) if names else set()


def _counted(group: Group, name: str) -> Counted:
    base, new = (
        {case.measured.seed: case.measured.counters[name] for case in side}
        for side in (group.base, group.new)
    )
    seeds = sorted(base.keys() & new.keys())
    sums = sum(base[seed] for seed in seeds), sum(new[seed] for seed in seeds)
    verdict, reason = _verdict(group, name, sums)
    if not seeds:
        verdict, reason = "not compared", "no seed is on both sides"
    elif all(base[seed] == new[seed] for seed in seeds):
        verdict, reason = "same", "the same number in each seed"
    return Counted(
        group=group, counter=name, verdict=verdict, base=sums[0], new=sums[1], reason=reason
    )


def _verdict(group: Group, name: str, sums: tuple[int, int]) -> tuple[Verdict, str]:
    """Verdict on sums over the common seeds whose numbers are not all the same, and its reason."""
    for part in SAME_BITS:
        base, new = (
            {case.environment.get(part) or "unknown" for case in side}
            for side in (group.base, group.new)
        )
        if len(base | new) > 1:
            told = f"{', '.join(sorted(base))} and {', '.join(sorted(new))}"
            return "not compared", f"computed with other {part}: {told}"
    if name not in WORK:
        return "changed", "other numbers in the same seeds"
    if sums[1] > sums[0] * (1 + WORK[name]):
        return "worse", f"more than {WORK[name]:.0%} more work"
    return "changed", f"not more than {WORK[name]:.0%} more work"
