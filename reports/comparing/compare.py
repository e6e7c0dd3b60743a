"""Two sides compared: every suite, scene, protocol, row and metric with its verdict."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from splatproof.base.errors import DataError
from splatproof.reports.comparable import MIN_SEEDS
from splatproof.reports.comparing.bands import Band, load_bands
from splatproof.reports.comparing.corrections import Correction, corrected, levels
from splatproof.reports.comparing.counters import Counted, counted
from splatproof.reports.comparing.deciding import Verdict, decide
from splatproof.reports.comparing.differing import Differing, differing
from splatproof.reports.comparing.estimate import Estimate, estimate
from splatproof.reports.comparing.matching import Failure, Group, NotComparable, match
from splatproof.reports.comparing.measures import (
    Measure,
    Tables,
    Unusable,
    measures,
    same_scores,
    tables,
    values_of,
)  # fmt: skip
from splatproof.reports.comparing.sides import Side
from splatproof.reports.comparing.timing import MACHINE_METRICS, why_not_timed

ALPHA = 0.05
"""Rate of false alarms over a whole run, and of each interval before correction."""
SEEDS = MIN_SEEDS
"""Seeds of either side that are asked for; two give an interval, though a wide one."""


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One metric of one group, and what the runs say of it."""

    group: Group
    measure: Measure
    verdict: Verdict
    reason: str
    """Why this verdict and no other, in one line."""
    base_mean: float
    """Mean over seeds and images (of a ratio: their geometric mean); nan where it has none."""
    new_mean: float
    images: int
    """Images behind it; 0 for a value of whole runs."""
    estimate: Estimate | None = None
    """The difference NEW - BASE, of logarithms where relative; None: not estimated."""
    p: float | None = None
    """p-value before correction; None: not one of the tests."""
    corrected_p: float | None = None
    level: float | None = None
    """Level at which the corrected interval is taken."""
    detectable: float | None = None
    """Smallest true difference that these runs would have shown, at the corrected level."""

    @property
    def seeds(self) -> tuple[int, int]:
        """Number of seeds of BASE and of NEW."""
        return len(self.group.base), len(self.group.new)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Everything that comparing two sides has found."""

    base: str
    """Label of the side that is compared with."""
    new: str
    """Label of the side that is judged."""
    alpha: float
    correction: Correction
    tests: int
    """Number of comparisons that the correction is for."""
    compared: tuple[Compared, ...]
    failures: tuple[Failure, ...]
    not_comparable: tuple[NotComparable, ...]
    not_judged: dict[str, str]
    """Why metrics that are there are not judged, by name: no better side, or no band and not asked for."""
    counters: tuple[Counted, ...]
    """Work that was done, compared exactly: no test, and not among `tests`."""
    differing: tuple[Differing, ...]
    remarks: tuple[str, ...]
    """What else must be said: results of a side that were left out."""

    @property
    def regressions(self) -> tuple[str, ...]:
        """A name for everything that got worse: metrics and counters of groups, and cases that newly fail."""
        worse = [
            f"{c.group.name} {c.measure.metric}" for c in self.compared if c.verdict == "worse"
        ]
        worse += [f"{c.group.name} {c.counter}" for c in self.counters if c.verdict == "worse"]
        return (*worse, *(f"{f.case} fails" for f in self.failures if f.on == "NEW"))

    @property
    def gone(self) -> tuple[str, ...]:
        """Cases and metrics that BASE has and NEW lacks, or has by other rules or on other views or pixels."""
        faults = self.not_comparable
        return tuple(one.what for one in faults if one.lacking == "NEW" or one.otherwise)

    @property
    def judged(self) -> tuple[Compared, ...]:
        """Comparisons that say anything: without those of times and memory that do not allow a verdict."""
        return tuple(one for one in self.compared if one.verdict != "not judged")

    @property
    def counts(self) -> Counter[Verdict]:
        """Number of comparisons by verdict."""
        return Counter(one.verdict for one in self.compared)


def compare(
    base: Side,
    new: Side,
    *,
    alpha: float = ALPHA,
    correction: Correction = "holm",
    metrics: Collection[str] = (),
    bands: Mapping[str, Band] | None = None,
) -> Comparison:
    """Judge every metric of every suite, scene, protocol and row that both sides have.

    The same seeds of the same code give the same bits, so what is identical is called so and needs no
    test. All others are tests that the correction is for, whatever their metric: one family, since one
    alarm is enough to stop a change. Metrics may depend on one another in any way.

    Args:
        base: The side that is compared with.
        new: The side that is judged.
        alpha: Rate of false alarms, in (0, 1).
        correction: How it is kept over many comparisons, see `corrections.corrected`.
        metrics: Metrics to judge; empty: those of the protocols and those with a declared band.
        bands: Declared noise bands by metric; None: ours.
    Returns: All verdicts in the order of groups and metrics, and everything that could not be compared.
    Raises: DataError where a side has no case; UsageError for a metric that no case has.
    """
    for side in (base, new):
        if not side.cases:
            raise DataError(f"{side.label}: no case, so there is nothing to compare")
    matched = match(base.cases, new.cases)
    bands = load_bands() if bands is None else bands
    judged, left_out = measures(matched.groups, bands, metrics)
    faults = list(matched.not_comparable)
    found: list[Compared] = []
    for group in matched.groups:
        for measure in judged:
            one = _compared(group, measure)
            if isinstance(one, NotComparable):
                faults.append(one)
            elif one is not None:
                found.append(one)
    return Comparison(
        base=base.label,
        new=new.label,
        alpha=alpha,
        correction=correction,
        tests=sum(one.estimate is not None for one in found),
        compared=tuple(_decided(found, correction, alpha)),
        failures=matched.failures,
        not_comparable=tuple(faults),
        not_judged=left_out,
        counters=tuple(counted(matched.groups)),
        differing=tuple(differing(matched.groups)),
        remarks=(*base.remarks, *new.remarks),
    )


def _compared(group: Group, measure: Measure) -> Compared | NotComparable | None:
    """A metric of a group before anything is corrected; None where no case of it has the metric."""
    lacking = {
        side: [case.measured.seed for case in own if measure.metric not in values_of(case)]
        for side, own in (("BASE", group.base), ("NEW", group.new))
    }
    if len(lacking["BASE"]) == len(group.base) and len(lacking["NEW"]) == len(group.new):
        return None
    for side, seeds in lacking.items():
        if seeds:
            why = f"{side} has none in seed {', '.join(map(str, seeds))}"
            lone = "" if all(lacking.values()) else side
            return NotComparable(what=f"{group.name} {measure.metric}", why=why, lacking=lone)
    scores, same = tables(group, measure), _same_models(group)
    identical = same and measure.metric not in MACHINE_METRICS and same_scores(group, measure)
    if isinstance(scores, Unusable) and not identical:
        return Compared(
            group=group, measure=measure, verdict=scores.verdict, reason=scores.why,
            base_mean=math.nan, new_mean=math.nan, images=0,
        )  # fmt: skip
    means, images = [math.nan, math.nan], 0
    if isinstance(scores, Tables):
        means = [float(side.mean()) for side in (scores.base, scores.new)]
        images = len(scores.images) if scores.images != ("",) else 0
    base_mean, new_mean = map(math.exp, means) if measure.relative else means
    plain = Compared(
        group=group, measure=measure, verdict="undecided", reason="",
        base_mean=base_mean, new_mean=new_mean, images=images,
    )  # fmt: skip
    if measure.metric in MACHINE_METRICS and (why := why_not_timed(measure.metric, group)):
        return replace(plain, verdict="not judged", reason=why)
    if identical:
        return replace(plain, verdict="equal", reason="identical: the same models and scores")
    fewest = min(plain.seeds)
    if fewest < 2:
        side = "BASE" if plain.seeds[0] < 2 else "NEW"
        return replace(plain, reason=f"one seed on {side} gives no interval; run at least {SEEDS}")
    assert isinstance(scores, Tables)
    return replace(plain, estimate=estimate(scores.new, scores.base, paired_seeds=same))


def _same_models(group: Group) -> bool:
    """Whether both sides are the same seeds with the very same models."""
    models = [
        [(case.measured.seed, case.model) for case in side] for side in (group.base, group.new)
    ]
    return models[0] == models[1] and all(model for _, model in models[0])


def _decided(found: Sequence[Compared], correction: Correction, alpha: float) -> Iterator[Compared]:
    """Every comparison with its verdict after correction for all that were tested."""
    p_values = [one.estimate.p_value for one in found if one.estimate is not None]
    tests = zip(
        p_values, corrected(p_values, correction), levels(p_values, correction, alpha), strict=True
    )
    for one in found:
        if one.estimate is None:
            yield one
            continue
        p, corrected_p, level = next(tests)
        verdict, reason = decide(one.estimate, one.measure, level, alpha)
        yield replace(
            one, verdict=verdict, reason=reason, p=p, corrected_p=corrected_p, level=level,
            detectable=one.estimate.detectable(level, one.measure.band or 0.0),
        )  # fmt: skip
