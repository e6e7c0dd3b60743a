"""The training curve on disk: what a killed case had logged is not logged again."""

import json
import time
from pathlib import Path

from splatproof.base.files import read_text, write_text
from splatproof.base.memory import peak_memory_mb
from splatproof.suites.case_costs import cpu_seconds

POINTS = 200
"""About this many points are kept, spread evenly over the steps."""


class Curve:
    """What one training run reports, as points (step, values) appended to a file of JSON lines.

    A run that continues from a checkpoint reports again the steps after it; those points are
    replaced. Each line also holds wall seconds, CPU seconds and the peak memory so far, over all attempts.
    """

    def __init__(self, path: Path) -> None:
        """Read the whole lines that an earlier attempt left in `path`."""
        self.path = path
        self._lines = _whole_lines(path)
        self._first = True
        self._start, self._began = cpu_seconds(), time.perf_counter()
        self._before = self._spent()

    def add(self, step: int, total: int, values: dict[str, float]) -> None:
        """Keep this point if it is the first of its 1/POINTS of the run, or the last.

        Args:
            step: Training step that was just done.
            total: Number of training steps.
            values: What the method says of the step by name.
        """
        if self._first:
            self._first = False
            self._lines = [line for line in self._lines if line["step"] < step]
            text = "".join(json.dumps(line) + "\n" for line in self._lines)
            write_text(self.path, text)
            self._before = self._spent()
        stride = max(1, total // POINTS)
        last = self._lines[-1]["step"] if self._lines else -1
        if step != total and step // stride == last // stride:
            return
        cpu, peak = self.spent()
        wall = self._before[2] + time.perf_counter() - self._began
        line = {"step": step, "values": values, "seconds": round(wall, 3)}
        line |= {"cpu_seconds": cpu, "peak_memory_mb": peak}
        self._lines.append(line)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def points(self) -> tuple[tuple[int, dict[str, float]], ...]:
        """All points, by step."""
        return tuple((line["step"], line["values"]) for line in self._lines)

    def seconds(self) -> tuple[float, ...]:
        """Wall seconds of the fit at each point, what comes before the first step included.

        Empty where an attempt of an earlier release began the curve without them.
        """
        known = all("seconds" in line for line in self._lines)
        return tuple(line["seconds"] for line in self._lines) if known else ()

    def spent(self) -> tuple[float, float]:
        """CPU seconds and peak memory (2^20 bytes) over all attempts, as far as they count."""
        cpu, peak, _ = self._before
        return cpu + cpu_seconds() - self._start, max(peak, peak_memory_mb())

    def _spent(self) -> tuple[float, float, float]:
        """CPU seconds, peak memory and wall seconds of earlier attempts at the last point that counts."""
        if not self._lines:
            return 0.0, 0.0, 0.0
        last = self._lines[-1]
        return last["cpu_seconds"], last["peak_memory_mb"], last.get("seconds", 0.0)


def _whole_lines(path: Path) -> list[dict]:
    """The lines of the file; a last one that a kill cut short is dropped."""
    if not path.exists():
        return []
    lines = read_text(path).split("\n")[:-1]
    return [json.loads(line) for line in lines]
