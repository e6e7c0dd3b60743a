"""What the process does that reads damaged files."""

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from fuzz import bounds
from fuzz.target import Target
from splatproof.base.memory import MEBIBYTE, peak_memory_mb

Build = Callable[[Path], Target]
"""Makes a target in an empty folder."""
MEMORY_FOLDER = Path("/dev/shm")
"""Where a file costs no disk; other systems have none."""


def made_targets(folder: Path, builders: Mapping[str, Build]) -> dict[str, Target]:
    """Targets, each in a folder of its own, read once so that nothing is imported later.

    Args:
        folder: An empty folder.
        builders: What builds each target.
    """
    made = {}
    for index, (name, build) in enumerate(builders.items()):
        place = folder / str(index)
        place.mkdir()
        target = made[name] = build(place)
        # without a bound on time: a fresh checkout's modules are compiled when they are first imported
        bounds.put(target, target.input(name, 0))
        target.read(target.path)
    return made


def scratch_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder for inputs, in memory where the system has such."""
    return tempfile.TemporaryDirectory(
        prefix="fuzz", dir=MEMORY_FOLDER if MEMORY_FOLDER.is_dir() else None
    )


def serve(note: Path, builders: Mapping[str, Build]) -> None:
    """Read orders from stdin, a line of JSON each: target, first, inputs; answer each with a line.

    Args:
        note: File that says which input is being read.
        builders: What builds each target.
    """
    with scratch_folder() as scratch, note.open("r+b", buffering=0) as noted:
        targets = made_targets(Path(scratch), builders)
        bounds.confine()
        held = peak_memory_mb() * MEBIBYTE
        print("ready", flush=True)
        for line in sys.stdin:
            name, first, inputs = json.loads(line)
            accepted, faults, begun = 0, {}, time.process_time()
            for number in range(first, first + inputs):
                os.pwrite(noted.fileno(), f"{number:20}".encode(), 0)
                answer = bounds.tried(targets[name], targets[name].input(name, number), held)
                accepted += answer.accepted
                if answer.fault:
                    faults[number] = answer.fault.replace(scratch, "")
            print(json.dumps([accepted, faults, time.process_time() - begun]), flush=True)
