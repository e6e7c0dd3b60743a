"""Noise bands: what another seed alone moves a metric by, declared in a file and measured from repeated seeds.

The band of a metric is one standard deviation from seed to seed, of a case's value. Few seeds cannot tell
so little from 0, so the interval decides with them; of many seeds the band decides, and a difference of
means that is certain, but smaller than what one other seed does, is of no account.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatproof.base.errors import UsageError
from splatproof.base.typed_toml import build, read_toml
from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.verdicts import untimed

DECLARED = Path(__file__).with_name("bands.toml")


@dataclass(frozen=True, kw_only=True)
class Band:
    """What is declared of a metric's noise."""

    unit: str
    """Unit of the value; "relative": a share of the value, and the metric is compared by ratios."""
    value: float
    """A difference of means within +- this is of no account."""
    measured: str
    """What it was measured on."""
    command: str
    """The command that measures it again."""

    def __post_init__(self) -> None:
        """Refuse a band that is none."""
        if not self.value >= 0:
            raise UsageError(f"value {self.value}: expected 0 or more")

    @property
    def relative(self) -> bool:
        """Whether the metric is compared by ratios."""
        return self.unit == "relative"


@dataclass(frozen=True, kw_only=True)
class _File:
    bands: dict[str, Band]


def load_bands(path: Path | None = None) -> dict[str, Band]:
    """Declared bands by metric.

    Args:
        path: A file of bands that replace or add to ours; None: ours alone.
    Raises: UsageError naming the file and the key where it is not such a file.
    """
    found = build(_File, read_toml(DECLARED), str(DECLARED)).bands
    if path is None:
        return found
    return found | build(_File, read_toml(path), str(path)).bands


@dataclass(frozen=True, kw_only=True)
class Repeated:
    """What repeated seeds say of a metric's noise."""

    metric: str
    relative: bool
    deviation: float
    """Standard deviation of a case's value from seed to seed, pooled over groups; a share where relative."""
    groups: int
    """Rows of scenes with at least two seeds behind it."""
    freedom: int
    """Degrees of freedom: seeds less one, summed over groups."""


def repeated(cases: Sequence[CaseRecord], relative: Mapping[str, bool]) -> list[Repeated]:
    """The noise of each metric, from cases that differ in the seed alone.

    Args:
        cases: Cases of any suites; failed ones are left out, and of costs those that
            `splatproof.reports.verdicts.untimed` says are not their own.
        relative: Whether a metric is compared by ratios; the metrics that are looked at, in order.
    Returns: Metrics with at least one group of two seeds; a group with a value that is not positive is
        no group of a relative metric.
    Source: ISO 5725-2, repeatability standard deviation.
    """
    groups: dict[tuple[str, str, str, str], list[CaseRecord]] = defaultdict(list)
    for case in cases:
        if not case.measured.error:
            groups[case.group].append(case)
    found = []
    for metric, by_ratio in relative.items():
        squares, freedom, count = 0.0, 0, 0
        for own in groups.values():
            counted = [c.measured for c in own if not untimed(metric, c.measured)]
            values = np.array([run.values.get(metric, math.nan) for run in counted])
            if len(values) < 2 or not np.isfinite(values).all() or (by_ratio and values.min() <= 0):
                continue
            values = np.log(values) if by_ratio else values
            squares += float(values.var(ddof=1)) * (len(values) - 1)
            freedom += len(values) - 1
            count += 1
        if count:
            deviation = math.sqrt(squares / freedom)
            found.append(
                Repeated(
                    metric=metric, relative=by_ratio, groups=count, freedom=freedom,
                    deviation=math.expm1(deviation) if by_ratio else deviation,
                )
            )  # fmt: skip
    return found
