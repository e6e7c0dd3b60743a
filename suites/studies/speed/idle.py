"""Whether other processes use this machine, which makes a timing mean little."""

import math
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
SHARE = 5.0
"""Percent of one core that others may use while something is timed."""
LOOK_SECONDS = 0.5
"""How long one look at the machine takes; the system counts in hundredths of a second."""


def busy_seconds() -> float:
    """CPU seconds that all processes have used since the machine started; nan if not told."""
    path = Path("/proc/stat")
    if not path.exists():
        return float("nan")
    ticks = [int(x) for x in path.read_text().split("\n", 1)[0].split()[1:9]]
    return (sum(ticks) - ticks[3] - ticks[4]) / os.sysconf("SC_CLK_TCK")


def process_seconds(pid: int) -> float:
    """CPU seconds of a process; 0 where it is gone or the system does not tell."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Watch:
    """What others use from now on."""

    def __init__(self, ours: Iterable[int]) -> None:
        """Start.

        Args:
            ours: Processes that are not others, beside this one.
        """
        self._ours = {os.getpid(), *ours}  # sessions may run in this process
        self._start = self._now()

    def _now(self) -> tuple[float, float, float]:
        own = sum(process_seconds(pid) for pid in self._ours)
        return busy_seconds(), own, time.perf_counter()

    def seconds(self) -> float:
        """Wall seconds since the start."""
        return time.perf_counter() - self._start[2]

    def percent(self) -> float:
        """Share of one core that others have used since the start, in percent; nan if not told."""
        busy, own, wall = (b - a for a, b in zip(self._start, self._now(), strict=True))
        percent = 100 * (busy - own) / wall
        return percent if math.isnan(percent) else max(0.0, percent)


class Patience:
    """Seconds that may be spent on waiting for others, in all."""

    def __init__(self, seconds: float) -> None:
        """Start with so many seconds."""
        self.left = seconds

    def spend(self, seconds: float) -> None:
        """Take some away."""
        self.left = max(0.0, self.left - seconds)

    def wait_for_idle(self, ours: Iterable[int]) -> float:
        """Return once others use little or the patience is at its end.

        Returns: What others used at the last look, in percent of one core; nan if not told.
        """
        ours = tuple(ours)
        while True:
            watch = Watch(ours)
            time.sleep(LOOK_SECONDS)
            percent = watch.percent()
            if not percent > SHARE or self.left <= 0:
                return percent
            self.spend(LOOK_SECONDS)


def undisturbed(
    work: Callable[[], T], patience: Patience, ours: Iterable[int] = (), *, anyway: bool = False
) -> tuple[T | None, float]:
    """Repeat `work` until others used little meanwhile, as long as the patience lasts.

    Args:
        work: Done at least once.
        patience: What is lost to others is taken from it.
        ours: Processes that are not others, beside this one.
        anyway: Take the first result, however disturbed.

    Returns: The result (None: it was disturbed every time) and what others used, in percent of one
        core.
    """
    ours = tuple(ours)
    while True:
        watch = Watch(ours)
        result = work()
        percent = watch.percent()
        if anyway or not percent > SHARE:
            return result, percent
        if patience.left <= 0:
            return None, percent
        patience.spend(watch.seconds())
        patience.wait_for_idle(ours)
