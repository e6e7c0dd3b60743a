"""`bench study speed`: error against speed, for everything that has a twin."""

import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.suites.studies.speed import neural
from splatproof.suites.studies.speed import roofline as speed_roofline
from splatproof.suites.studies.speed.idle import SHARE, Patience, Watch, undisturbed
from splatproof.suites.studies.speed.session import Open, Process, Session, Task, with_backend
from splatproof.suites.twins.registry import COMPONENTS
from splatproof.suites.twins.twin import Case, Component, Twin

Row = dict[str, Any]
Run = tuple[float, float]
"""Milliseconds forward and backward."""
Turns = dict[str, list[Run]]
"""Runs of each twin in one round."""
NO_MEMORY = dict.fromkeys(("peak_mb", "added_mb", "device_mb"))
ROUNDS, QUICK_ROUNDS = 5, 2
"""Rounds of a case, and in the reduced form: in each, every twin has its turn."""
TURN_SECONDS = 0.1
"""Least length of a turn; a twin that takes longer runs once."""
BUSY_ROUNDS, BUSY_SECONDS, LEAST_ROUNDS = 15, 30.0, 3
"""Most rounds of a case that others disturb, seconds after which no further one is begun, and fewest."""
ROUND_SECONDS = 1.0
"""Least length of a round in the full form: the system counts what others use in steps of 0.01 s."""


def rows(
    *,
    quick: bool,
    wait: float = 300.0,
    backend: str = "cpu",
    only: str | None = None,
    kept: Sequence[Row] = (),
    open_session: Open = Process,
) -> Iterator[Row]:
    """A row a twin and case, one a method with networks, one a stage of the engine against the machine's peak.

    Keys: component, twin, case, forward_ms, backward_ms (medians of interleaved runs; None where
    there is none), ratio, ratio_low, ratio_high (time of both passes in units of the usual twin's, median
    over rounds in which both had their turn, and its interval, see `ratios`), max_abs_error, rms_error,
    grad_rel_l2, grad_cosine, discontinuity_pixels (against the float64 reference on error_case), peak_mb
    (of a process that does nothing else), added_mb (of that, beyond what it held before the first run),
    device_mb, contributing_pairs, usual (the twin that users get), approximates, disturbed_percent (share
    of a core that other processes used meanwhile, nan where the system does not tell), ok, note. Whole training
    steps of methods with networks have more keys, see `neural.facts`; their errors are against torch's networks.

    Each case waits until the machine is idle. A round during which others used more than 5 % of a
    core is thrown away and repeated, as long as `wait` lasts; after that the row has no times but ratios:
    turns of a round are neighbours, so what others do meets all twins, those of several threads most. The
    reduced form does not wait: it marks such rows, and its times mean little.

    Args:
        quick: Small cases, fewer rounds.
        wait: Seconds that may be lost to other processes in the whole study.
        backend: "cpu", or "cuda" to add gsplat's twins.
        only: Pattern of shells on component/case; None: all. Whole steps of methods with networks are component
            `neural step`, the engine's stages `roofline`.
        kept: Rows of an earlier call that was ended; their cases are not measured again.
        open_session: How twins are run; in a process of its own each.

    Raises: UsageError for another backend, or if no case is chosen.
    """
    if backend not in ("cpu", "cuda"):
        raise UsageError(f"backend {backend!r}: the speed study compares cpu and cuda")
    patience = Patience(0.0 if quick else wait)
    named = "" if backend == "cpu" else backend
    timer = Timer(quick=quick, patience=patience, backend=named, open_session=open_session)
    known: dict[tuple[str, str], list[Row]] = {}
    for row in kept:
        known.setdefault((row["component"], row["case"]), []).append(row)
    found = False
    for name in COMPONENTS:
        component = with_backend(name, named)
        cases = [
            case
            for case in timed_cases(component, quick=quick)
            if _chosen(only, name, component.label(case.size))
        ]
        found = found or bool(cases)
        yield from timer.component(component, cases, known)
    for case in neural.CASES:
        if case.quick == quick and _chosen(only, neural.COMPONENT, case.label):
            found = True
            yield from known.get((neural.COMPONENT, case.label)) or timer.steps(case)
    if _chosen(only, "roofline", ""):
        yield from speed_roofline.rows(quick=quick, patience=patience)
    elif not found:
        every = [
            f"{name}/{c.label(case.size)}"
            for name, c in COMPONENTS.items()
            for case in timed_cases(c, quick=quick)
        ] + [f"{neural.COMPONENT}/{case.label}" for case in neural.CASES if case.quick == quick]
        raise UsageError(f"--only {only}: none of the cases {', '.join(every)}, roofline")


def timed_cases(component: Component, *, quick: bool) -> list[Case]:
    """Cases that twins of a component are timed in, the one that errors are judged on first.

    Args:
        component: One of the registry.
        quick: Only those of the reduced form.
    """
    judged = [] if component.reference is None else [Case(size=component.judged, quick=True)]
    more = [
        case
        for case in component.cases
        if component.reference is not None or case.size != component.judged
    ]
    return [case for case in (*judged, *more) if case.quick or not quick]


def _chosen(only: str | None, component: str, case: str) -> bool:
    return only is None or any(
        fnmatchcase(name, only) for name in (component, f"{component}/{case}")
    )


class Timer:
    """How cases are timed."""

    def __init__(self, *, quick: bool, patience: Patience, backend: str, open_session: Open):
        """Keep the settings of the study.

        Args:
            quick: Measure the reduced form, and whatever others use of the machine.
            patience: How long to wait until nobody else uses the machine.
            backend: Further backend whose twins take part; empty: none.
            open_session: Starts a twin in a process of its own.
        """
        self.quick, self.patience = quick, patience
        self.backend, self.open = backend, open_session

    def component(
        self,
        component: Component,
        cases: Sequence[Case],
        known: Mapping[tuple[str, str], list[Row]],
    ) -> Iterator[Row]:
        """All rows of some cases of one component.

        Args:
            component: One of the registry.
            cases: What its twins are timed in.
            known: Rows by component and case that are there already.
        """
        errors: dict[str, Any] = {}
        for case in cases:
            there = known.get((component.name, component.label(case.size)))
            if there:
                yield from there
                continue
            errors = errors or self.judged(component)
            twins = [twin for twin in component.twins if takes_part(component, twin, case)]
            for row in self.case(component, case, twins):
                yield row | {
                    **errors[row["twin"]], "error_case": component.label(component.judged),
                    "ok": errors[row["twin"]]["ok"] and row["ok"],
                }  # fmt: skip

    def judged(self, component: Component) -> dict[str, Any]:
        """Errors of every twin of a component, by name."""
        task = Task(component=component.name, size=component.judged, backend=self.backend)
        session = self.open(task)
        try:
            return session.ask("judge")
        finally:
            session.close()

    def case(self, component: Component, case: Case, twins: list[Twin]) -> Iterator[Row]:
        """Time the twins of one case in turns; one that cannot start is a row without times.

        Args:
            component: Component that the twins implement.
            case: Size that they are timed at.
            twins: Twins that take part.
        """
        sessions: dict[str, Session] = {}
        failed: dict[str, str] = {}
        try:
            for twin in twins:
                task = Task(
                    component=component.name, size=case.size, twin=twin.name,
                    backward=not case.forward_only, backend=self.backend,
                )  # fmt: skip
                try:
                    sessions[twin.name] = self.open(task)
                except SplatproofError as error:
                    failed[twin.name] = str(error)
            rounds, percent = self.rounds(sessions)
            memory = {name: session.ask("memory") for name, session in sessions.items()}
            pairs = next(iter(sessions.values())).ask("pairs") if sessions else None
        finally:
            for session in sessions.values():
                session.close()
        timed, relative = self.told(rounds, percent)
        for twin in twins:
            runs = [run for turns in timed for run in turns.get(twin.name, [])]
            low, middle, high = ratios(rounds, twin.name, component.usual)
            yield {
                "component": component.name, "twin": twin.name,
                "case": component.label(case.size), "size": list(case.size),
                "forward_ms": median([run[0] for run in runs]),
                "backward_ms": median([run[1] for run in runs]),
                "ratio": middle, "ratio_low": low, "ratio_high": high,
                **memory.get(twin.name, NO_MEMORY), "contributing_pairs": pairs,
                "usual": twin.name == component.usual, "growth": case.growth,
                "approximates": twin.approximates, "disturbed_percent": percent,
                "ok": twin.name not in failed, "note": failed.get(twin.name, relative),
            }  # fmt: skip

    def steps(self, case: neural.Case) -> Iterator[Row]:
        """Time training steps of the methods of one case in turns, in this process.

        Args:
            case: Methods and their scene.
        """
        sessions = neural.sessions(case)
        rounds, percent = self.rounds(sessions)
        timed, relative = self.told(rounds, percent)
        size = case.size
        for name, session in sessions.items():
            low, middle, high = ratios(rounds, name, case.usual)
            yield {
                "component": neural.COMPONENT, "twin": name, "case": case.label,
                "size": [size.gaussians, size.width, size.height],
                "forward_ms": median([run[0] for turns in timed for run in turns[name]]),
                "backward_ms": None, "ratio": middle, "ratio_low": low, "ratio_high": high,
                **NO_MEMORY, "contributing_pairs": None, "usual": name == case.usual, "growth": False,
                "approximates": "", "rms_error": None, "discontinuity_pixels": None,
                "error_case": "torch's networks", "disturbed_percent": percent, "note": relative,
                **neural.facts(name, session, quick=self.quick),
            }  # fmt: skip

    def told(self, rounds: list[Turns], percent: float) -> tuple[list[Turns], str]:
        """Rounds that times may be read of, and what their rows note.

        Args:
            rounds: What was measured.
            percent: What others used meanwhile, of one core.
        """
        disturbed = f"others used {percent:.0f} % of a core" if percent > SHARE else ""
        if self.quick or not disturbed:
            return rounds, disturbed
        return [], f"{disturbed}: no times, but ratios"

    def rounds(self, sessions: Mapping[str, Session]) -> tuple[list[Turns], float]:
        """Rounds that nobody disturbed, or else disturbed ones, and the most that others used."""
        pids = [session.pid for session in sessions.values()]
        seconds = TURN_SECONDS
        if not self.quick:
            seconds = max(seconds, ROUND_SECONDS / max(1, len(sessions)))

        def turns() -> Turns:
            return {name: one.ask("turn", seconds) for name, one in sessions.items()}

        quiet: list[Turns] = []
        shares: list[float] = []
        self.patience.wait_for_idle(pids)
        for _ in range(QUICK_ROUNDS if self.quick else ROUNDS):
            found, percent = undisturbed(turns, self.patience, pids, anyway=self.quick)
            if found is None:  # patience is at its end; rounds that were quiet still count
                return (quiet, max(shares)) if quiet else self.busy(turns, pids)
            shares.append(percent)
            quiet.append(found)
        return quiet, max(shares)

    def busy(self, turns: Callable[[], Turns], pids: list[int]) -> tuple[list[Turns], float]:
        """Rounds beside others: more of them, since each is rougher.

        Args:
            turns: One round.
            pids: Processes of ours.

        Returns: The rounds, and what others used, in percent of one core.
        """
        found: list[Turns] = []
        watch = Watch(pids)
        while len(found) < LEAST_ROUNDS or (
            len(found) < BUSY_ROUNDS and watch.seconds() < BUSY_SECONDS
        ):
            found.append(turns())
        return found, watch.percent()


def ratios(
    rounds: Sequence[Turns], twin: str, usual: str
) -> tuple[float | None, float | None, float | None]:
    """Time of a twin in units of the usual one's: interval and median over rounds; None without both.

    A round's ratio is that of the medians of both turns. The interval goes from one order statistic to
    another, as many from either end as still hold the median in 95 of 100 draws; with fewer than six
    rounds, which hold it in fewer, from the least to the greatest.

    Args:
        rounds: Runs of each twin in each round.
        twin: Which is asked for.
        usual: What it is held against.

    Source: sign-test interval of a median: Conover, "Practical Nonparametric Statistics", Sec. 3.2.
    """
    found = sorted(
        _milliseconds(turns[twin]) / _milliseconds(turns[usual])
        for turns in rounds
        if turns.get(twin) and turns.get(usual)
    )
    if not found:
        return None, None, None
    left_out = 0
    while binomial_tail(len(found), left_out + 2) <= 0.025:
        left_out += 1
    return found[left_out], statistics.median(found), found[-1 - left_out]


def binomial_tail(count: int, outside: int) -> float:
    """Chance that fewer than `outside` of `count` fair coins show heads.

    Args:
        count: Number of coins.
        outside: Number of heads that is not reached.
    """
    return sum(math.comb(count, heads) for heads in range(outside)) / 2**count


def _milliseconds(runs: Sequence[Run]) -> float:
    """Median of both passes together; those without a backward pass count forwards."""
    return statistics.median(
        forward + (0.0 if math.isnan(backward) else backward) for forward, backward in runs
    )


def takes_part(component: Component, twin: Twin, case: Case) -> bool:
    """Whether a twin is timed in a case.

    Args:
        component: Component that the twin implements.
        twin: Implementation in question.
        case: Size that would be timed.
    """
    if case.growth:
        return twin.name == component.usual or twin.device_mb is not None
    return case.size == component.judged or twin.most is None or case.size[0] <= twin.most


def median(values: list[float]) -> float | None:
    """Median of the values; None without any or without numbers."""
    return statistics.median(values) if values and not math.isnan(values[0]) else None


def pictures(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw the study's pictures into the folder.

    Args:
        rows: Rows of the speed study.
        folder: Folder of the pictures.
    """
    from splatproof.suites.studies.speed.plot import draw  # matplotlib is slow to import

    return draw(rows, folder)
