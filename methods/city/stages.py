"""The stages of a run that are done, on disk: a killed run goes on at the one that was broken off."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from splatproof.base.errors import UsageError
from splatproof.base.files import read_text, write_text
from splatproof.base.memory import peak_within
from splatproof.methods.training.run_keys import what_differs


class Stages:
    """What each finished stage left to be known, and its seconds."""

    def __init__(self, folder: Path, key: str, on_stage: Callable[[str, float], None]) -> None:
        """Read what is there.

        Args:
            folder: Where the record of finished stages lies (city.json).
            key: Everything that the run depends on, as text.
            on_stage: Called as on_stage(name, wall seconds) for each stage, finished before or now.

        Raises: UsageError if the folder belongs to another run.
        """
        self.path, self.key, self.on_stage = folder / "city.json", key, on_stage
        self.done: dict[str, dict[str, Any]] = {}
        if self.path.exists():
            stored = json.loads(read_text(self.path))
            if stored["key"] != key:
                raise UsageError(
                    f"{self.path}: belongs to a run that differs: {what_differs(stored['key'], key)}; "
                    "remove the folder or choose another one"
                )
            self.done = stored["stages"]

    def run(
        self,
        name: str,
        work: Callable[[], dict[str, Any] | None],
        there: Callable[[], bool] = lambda: True,
    ) -> dict[str, Any]:
        """Do a stage unless it is done.

        Args:
            name: Name of the stage, unique in the run.
            work: Does it and returns what is to be known of it, JSON-ready. It may name "seconds"
                and "cpu_seconds" itself, where a part of it was done before or elsewhere; else they are
                measured in this process. "peak_mb" is the memory of the largest process of such a part, in 2^20
                bytes, 0 where who did it has not said: then that of the stage is not known.
            there: Whether what it made is still there, which lies in a cache that others may empty.

        Returns: What is known of the stage, with its wall and processor seconds, and with "peak_mb", the peak memory
            of the largest process that did it (or ended it, after an interruption), where that is known.
        """
        if name not in self.done or not there():
            started, before = time.perf_counter(), time.process_time()
            here: dict[str, float] = {}
            with peak_within(here, name):
                facts = work() or {}
            passed = time.perf_counter() - started
            elsewhere = facts.get("peak_mb")
            if elsewhere != 0:
                facts["peak_mb"] = max(here.get(name, 0.0), elsewhere or 0.0)
            facts["seconds"] = max(passed, facts.get("seconds", 0.0))
            facts.setdefault("cpu_seconds", time.process_time() - before)
            self.done[name] = facts
            write_text(self.path, json.dumps({"key": self.key, "stages": self.done}) + "\n")
        self.on_stage(name, self.done[name]["seconds"])
        return self.done[name]

    @property
    def seconds(self) -> dict[str, float]:
        """Wall seconds of each stage that is done."""
        return {name: facts["seconds"] for name, facts in self.done.items()}

    @property
    def cpu_seconds(self) -> dict[str, float]:
        """Processor seconds of each stage that is done; what other processes did may not be in them."""
        return {name: facts.get("cpu_seconds", 0.0) for name, facts in self.done.items()}

    @property
    def peak_mb(self) -> dict[str, float]:
        """Peak memory of the largest process of each stage that is done, in 2^20 bytes, where it is known."""
        found = {name: facts.get("peak_mb", 0.0) for name, facts in self.done.items()}
        return {name: peak for name, peak in found.items() if peak}
