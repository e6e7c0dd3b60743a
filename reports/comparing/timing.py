"""Whether times and memory of two sides may be compared: one machine, turn by turn, undisturbed."""

import datetime

from splatproof.metrics.scene_registry import STAGES
from splatproof.reference.types.result import BEGAN, BOOT, ENDED
from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.matching import Group
from splatproof.reports.verdicts import TIMES, untimed

MACHINE_METRICS = (*TIMES, "peak_memory_mb", *(f"{stage}_peak_mb" for stage in STAGES))
"""What a case costs that depends on where and when it was measured."""
SAME_PLACE = (BOOT, "cpu", "cores", "threads", "simd", "backend", "platform")
"""What all runs must have alike."""
APART = 0.4
"""Share of the whole span of time that the mean moments of both sides may lie apart. A drift of the
machine moves the sides apart by its size times this: 0.2 for turns A B A B A B, 0 for A B B A, and 0.6
where all of A ran before B."""


def why_not_timed(metric: str, group: Group) -> str:
    """Why a time or memory is not judged; empty where it may be.

    Args:
        metric: One of MACHINE_METRICS.
        group: Finished cases of both sides.
    Source: ours; turns against drift as in any interleaved design (Box, Hunter and Hunter 2005, blocking).
    """
    base, new = group.base, group.new
    every = [*base, *new]
    if any(not case.environment.get(name) for case in every for name in (BOOT, BEGAN, ENDED)):
        return "the records do not say when and on which machine they ran (older than that)"
    for name in SAME_PLACE:
        if len({case.environment.get(name, "") for case in every}) > 1:
            kind = (
                "another start of the machine, or another one" if name == BOOT else f"other {name}"
            )
            return f"not measured on the same machine ({kind})"
    for case in every:
        if why := untimed(metric, case.measured):
            return f"{why} ({case.name})"
    middles = [[_middle(case) for case in side] for side in (base, new)]
    first, last = min(map(min, middles)), max(map(max, middles))
    apart = abs(sum(middles[0]) / len(base) - sum(middles[1]) / len(new))
    if apart > APART * (last - first):
        return "the runs of both sides were not interleaved: one side ran before the other"
    return ""


def _middle(case: CaseRecord) -> float:
    """Moment half-way through a case's training, seconds since 1970."""
    ends = (datetime.datetime.fromisoformat(case.environment[name]) for name in (BEGAN, ENDED))
    return sum(moment.timestamp() for moment in ends) / 2
