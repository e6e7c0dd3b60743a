"""Watches the process that reads damaged files: it may hang, die or eat the machine."""

import json
import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

PROGRAM = Path(__file__).with_name("targets.py")
"""What reads every kind of file."""
HANGS = 60
"""Seconds of wall time at one input after which the process is ended: native code hears no signal."""
STARTS = 600
"""Seconds that its imports may take on a machine with much other work."""


@dataclass(frozen=True)
class Batch:
    """What came of some inputs of a target."""

    done: int
    accepted: int
    seconds: float
    faults: dict[int, str]
    """Number of the input: what is wrong."""


class Reader:
    """The second process, started again when it dies. Use it in a `with` block."""

    def __init__(self, folder: Path, program: Path = PROGRAM, hangs: float = HANGS) -> None:
        """Nothing starts yet.

        Args:
            folder: Where its note and its last words are kept.
            program: Calls `serve` with the path that is its argument.
            hangs: Seconds at one input after which the process is ended.
        """
        self._program, self._hangs = program, hangs
        folder.mkdir(parents=True, exist_ok=True)
        self._note, self._words = folder / "note", folder / "stderr"
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        """Itself; it starts when it is needed."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the process."""
        self._end()

    def read(self, name: str, first: int, inputs: int) -> Batch:
        """Have some inputs of a target read.

        Args:
            name: The target.
            first: Number of the first input.
            inputs: How many.
        """
        process = self._started()
        assert process.stdin is not None
        process.stdin.write(json.dumps([name, first, inputs]) + "\n")
        process.stdin.flush()
        answer = self._line(process, self._hangs)
        if answer:
            accepted, faults, seconds = json.loads(answer)
            return Batch(inputs, accepted, seconds, {int(n): fault for n, fault in faults.items()})
        at = int(self._note.read_text())
        ended = f"ends the process with code {process.wait()}" if answer is not None else ""
        self._end()
        # what was read before it is read again in another process, which finds it again
        before = self.read(name, first, at - first) if at > first else Batch(0, 0, 0.0, {})
        fault = ended or f"hangs for {self._hangs:g} s"
        return Batch(before.done + 1, before.accepted, before.seconds, before.faults | {at: fault})

    def _line(self, process: subprocess.Popen[str], hangs: float) -> str | None:
        """The next line that it says; empty where it has ended, None where it stays at one input."""
        assert process.stdout is not None
        at, since = "", time.monotonic()
        while not select.select([process.stdout], [], [], 1)[0]:
            now = self._note.read_text()
            at, since = (at, since) if now == at else (now, time.monotonic())
            if time.monotonic() - since > hangs:
                return None
        return process.stdout.readline()

    def _started(self) -> subprocess.Popen[str]:
        if self._process is None:
            self._note.write_text(f"{0:20}")
            environment = os.environ | {
                "OMP_NUM_THREADS": "1",
                "PYTHONPATH": str(Path(__file__).parents[1]),
            }
            with self._words.open("a") as words:
                self._process = subprocess.Popen(
                    [sys.executable, "-P", str(self._program), str(self._note)], env=environment, text=True,
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=words,
                )  # fmt: skip
            answer = self._line(self._process, STARTS)
            if answer != "ready\n":
                why = "hangs" if answer is None else f"ends with code {self._process.wait()}"
                self._end()
                raise RuntimeError(f"the reading process {why} before it reads; see {self._words}")
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                assert pipe is not None
                pipe.close()
            self._process = None
