"""Starts a command, ends it at a moment, and looks at what it leaves."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from torture.commands import Command

BENCH = str(Path(sys.executable).with_name("bench"))
MARK = "SPLATPROOF_TORTURE"
"""Variable in the environment of a command and all its children: nothing else finds orphans surely."""
ORPHANS_END = 2.0
"""Seconds after the command's end in which its children end too."""
ENDS = 60.0
"""Seconds in which a command ends that was told to, on a machine with much other work."""
SIGNALS = (("SIGKILL",), ("SIGKILL",), ("SIGTERM",), ("SIGINT",), ("SIGINT", "SIGINT"))
WHOM = ("process", "group", "worker")


@dataclass(frozen=True)
class Kill:
    """When and how a command is ended."""

    moment: float
    """Share of the time that the undisturbed command took."""
    signals: tuple[str, ...]
    """Sent one after another."""
    whom: str
    """Who gets them: one of WHOM; a worker is one of the command's children, where it has any."""
    gap: float = 0.0
    """Seconds between two signals."""


def drawn(draw: random.Random) -> Kill:
    """A kill at random.

    Args:
        draw: Where chance comes from.
    """
    return Kill(
        draw.uniform(0.0, 1.05), draw.choice(SIGNALS), draw.choice(WHOM), draw.uniform(0.0, 0.4)
    )


def started(command: Command, folder: Path, mark: str) -> subprocess.Popen[str]:
    """The command in a session of its own.

    Args:
        command: Which.
        folder: Where it runs.
        mark: Value of MARK for it and its children.
    """
    environment = os.environ | {
        MARK: mark,
        "OMP_NUM_THREADS": "1",
        "MLFLOW_DISABLE_TELEMETRY": "true",
    }
    environment.pop("MLFLOW_TRACKING_URI", None)
    with (folder / "stderr").open("w") as said:
        return subprocess.Popen(
            [*(command.program or (BENCH,)), *command.arguments], cwd=folder, env=environment, text=True, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=said,
        )  # fmt: skip


def marked(mark: str) -> Iterator[int]:
    """Processes that have the mark in their environment (Linux), zombies left out.

    Args:
        mark: Value of MARK.
    """
    wanted = f"{MARK}={mark}".encode()
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            if wanted in (entry / "environ").read_bytes().split(b"\0"):
                yield int(entry.name)
        except OSError:  # it has ended, or is not ours
            continue


def kill(
    command: Command,
    folder: Path,
    seconds: float,
    how: Kill,
    mark: str,
    wanted: Mapping[str, object],
) -> list[str]:
    """Start the command, end it, and say what is wrong with how it ended.

    Args:
        command: Which.
        folder: Where it runs.
        seconds: How long it takes undisturbed.
        how: When, how and whom.
        mark: Value of MARK; of this one start alone.
        wanted: What the undisturbed command left.
    """
    process = started(command, folder, mark)
    try:
        process.wait(timeout=how.moment * seconds)
    except subprocess.TimeoutExpired:
        _send(process, how, mark)
    try:
        # a command whose worker died, or got what workers do not hear, may go on to its end
        code = process.wait(timeout=ENDS + (4 * seconds if how.whom == "worker" else 0))
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return [f"does not end within {ENDS:.0f} s"]
    faults = []
    until = time.monotonic() + ORPHANS_END
    while (left := list(marked(mark))) and time.monotonic() < until:
        time.sleep(0.05)
    for pid in left:
        faults.append(f"orphan after {ORPHANS_END:.0f} s: {_called(pid)}")
        os.kill(pid, signal.SIGKILL)
    said = (folder / "stderr").read_text(errors="replace")
    if "Traceback" in said:
        faults.append(f"a traceback, exit code {code}: {said.strip().splitlines()[-1][:200]}")
    present = command.outcome(folder) if command.whole else {}
    faults += [f"half-made: {name}" for name in present if present[name] != wanted.get(name)]
    for name in command.whole:
        if (folder / name).is_dir() and present.keys() != wanted.keys():
            faults.append(f"half-made: {name} has {len(present)} of {len(wanted)} files")
    return faults


def _send(process: subprocess.Popen[str], how: Kill, mark: str) -> None:
    """Send the signals."""
    target = process.pid
    if how.whom == "worker":
        children = sorted(set(marked(mark)) - {process.pid})
        target = children[int(how.gap * 1e6) % len(children)] if children else process.pid
    for number, name in enumerate(how.signals):
        if number:
            time.sleep(how.gap)
        try:
            if how.whom == "group":
                os.killpg(process.pid, signal.Signals[name])
            else:
                os.kill(target, signal.Signals[name])
        except ProcessLookupError:
            return


def _called(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()[:150]
    except OSError:
        return "ended meanwhile"


def finished(command: Command, folder: Path, mark: str, seconds: float = 1200) -> float:
    """Run the command to its end and return the seconds it took.

    Args:
        command: Which.
        folder: Where it runs.
        mark: Value of MARK.
        seconds: After which it is given up.

    Raises: AssertionError where it fails.
    """
    begun = time.monotonic()
    code = started(command, folder, mark).wait(timeout=seconds)
    said = (folder / "stderr").read_text(errors="replace")
    if code == 2 and command.whole and "exists already" in said:  # killed after its end
        return time.monotonic() - begun
    assert code == 0, f"{command.arguments[0]} ended with {code}: {said[-2000:]}"
    return time.monotonic() - begun


def left_over(folder: Path) -> list[str]:
    """Files and folders that work in progress leaves and a finished command must not.

    Args:
        folder: Where the command ran.
    """
    return sorted(
        str(path.relative_to(folder)) for path in folder.rglob("*")
        if path.name.endswith(".partial") or path.name == "checkpoint"
    )  # fmt: skip


def differences(found: Mapping[str, object], wanted: Mapping[str, object]) -> list[str]:
    """Names of what is missing, too many or other than in the undisturbed command's result.

    Args:
        found: After kills and the end.
        wanted: Undisturbed.
    """
    return [
        *(f"missing: {name}" for name in wanted.keys() - found.keys()),
        *(f"too many: {name}" for name in found.keys() - wanted.keys()),
        *(
            f"differs: {name}"
            for name in sorted(wanted.keys() & found.keys())
            if found[name] != wanted[name]
        ),
    ]
