"""`bench study speed`: error against speed, for everything that has a twin."""

import math
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.suites.studies.speed import roofline as speed_roofline
from splatproof.suites.studies.speed.idle import SHARE, Patience, undisturbed
from splatproof.suites.studies.speed.session import Open, Process, Session, Task, with_backend
from splatproof.suites.twins.registry import COMPONENTS
from splatproof.suites.twins.twin import Case, Component, Twin

Row = dict[str, Any]
Run = tuple[float, float]
"""Milliseconds forward and backward."""
NO_MEMORY = dict.fromkeys(("peak_mb", "added_mb", "device_mb"))
ROUNDS, QUICK_ROUNDS = 5, 2
"""Rounds of a case, and in the reduced form: in each, every twin has its turn."""
TURN_SECONDS = 0.1
"""Least length of a turn; a twin that takes longer runs once."""
ROUND_SECONDS = 1.0
"""Least length of a round in the full form: the system counts what others use in steps of 0.01 s."""


def rows(
    *, quick: bool, wait: float = 300.0, backend: str = "cpu", open_session: Open = Process
) -> Iterator[Row]:
    """A row a twin and case, then a row a stage of the engine against the machine's peak.

    Keys: component, twin, case, forward_ms, backward_ms (medians of interleaved runs; None where
    there is none), max_abs_error, rms_error, grad_rel_l2, grad_cosine, discontinuity_pixels (against the
    float64 reference on error_case), peak_mb (of a process that does nothing else), added_mb (of
    that, beyond what it held before the first run), device_mb, contributing_pairs, usual (the twin
    that users get), approximates, disturbed_percent (share of a core that other processes used
    meanwhile, nan where the system does not tell), ok, note.

    Each case waits until the machine is idle. A round during which others used more than 5 % of a
    core is thrown away and repeated, as long as `wait` lasts; then the row comes without times and
    is not ok. The reduced form does not wait: it marks such rows, and its times mean little.

    Args:
        quick: Small cases, fewer rounds.
        wait: Seconds that may be lost to other processes in the whole study.
        backend: "cpu", or "cuda" to add gsplat's twins.
        open_session: How twins are run; in a process of its own each.

    Raises: UsageError for another backend.
    """
    if backend not in ("cpu", "cuda"):
        raise UsageError(f"backend {backend!r}: the speed study compares cpu and cuda")
    patience = Patience(0.0 if quick else wait)
    named = "" if backend == "cpu" else backend
    timer = Timer(quick=quick, patience=patience, backend=named, open_session=open_session)
    for name in COMPONENTS:
        yield from timer.component(with_backend(name, named))
    yield from speed_roofline.rows(quick=quick, patience=patience)


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

    def component(self, component: Component) -> Iterator[Row]:
        """All rows of one component."""
        session = self.open(
            Task(component=component.name, size=component.judged, backend=self.backend)
        )
        errors = session.ask("judge")
        session.close()
        for case in (Case(size=component.judged, quick=True), *component.cases):
            if component.reference is None and case.size == component.judged:
                continue
            if self.quick and not case.quick:
                continue
            twins = [twin for twin in component.twins if takes_part(component, twin, case)]
            for row in self.case(component, case, twins):
                yield row | {
                    **errors[row["twin"]], "error_case": component.label(component.judged),
                    "ok": errors[row["twin"]]["ok"] and row["ok"],
                }  # fmt: skip

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
            runs, percent = self.rounds(sessions)
            memory = {name: session.ask("memory") for name, session in sessions.items()}
            pairs = next(iter(sessions.values())).ask("pairs") if sessions else None
        finally:
            for session in sessions.values():
                session.close()
        disturbed = f"others used {percent:.0f} % of a core" if percent > SHARE else ""
        for twin in twins:
            times = runs.get(twin.name, [])
            refused = f"refused: {disturbed} for as long as the study may wait (--wait)"
            yield {
                "component": component.name, "twin": twin.name,
                "case": component.label(case.size), "size": list(case.size),
                "forward_ms": median([run[0] for run in times]),
                "backward_ms": median([run[1] for run in times]),
                **memory.get(twin.name, NO_MEMORY), "contributing_pairs": pairs,
                "usual": twin.name == component.usual, "growth": case.growth,
                "approximates": twin.approximates, "disturbed_percent": percent,
                "ok": bool(times),
                "note": failed.get(twin.name, disturbed if times else refused),
            }  # fmt: skip

    def rounds(self, sessions: dict[str, Session]) -> tuple[dict[str, list[Run]], float]:
        """Runs of each session in the rounds that nobody disturbed, and the most others used."""
        pids = [session.pid for session in sessions.values()]
        seconds = TURN_SECONDS
        if not self.quick:
            seconds = max(seconds, ROUND_SECONDS / max(1, len(sessions)))
        runs: dict[str, list[Run]] = {name: [] for name in sessions}
        shares: list[float] = []
        self.patience.wait_for_idle(pids)
        for _ in range(QUICK_ROUNDS if self.quick else ROUNDS):
            turns, percent = undisturbed(
                lambda: {n: one.ask("turn", seconds) for n, one in sessions.items()},
                self.patience, pids, anyway=self.quick,
            )  # fmt: skip
            if turns is None:  # patience is at its end; rounds that were quiet still count
                return runs, max(shares, default=percent)
            shares.append(percent)
            for name, turn in turns.items():
                runs[name].extend(turn)
        return runs, max(shares)


def takes_part(component: Component, twin: Twin, case: Case) -> bool:
    """Whether a twin is timed in a case.

    Args:
        component: Component that the twin implements.
        twin: Implementation in question.
        case: Size that would be timed.
    """
    if case.growth:
        return twin.name == component.usual
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
