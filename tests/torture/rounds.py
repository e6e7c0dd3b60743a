"""Kill commands at random moments, start them again, and compare with undisturbed ones: `make torture`.

A round is a fresh folder, a few kills of one command and its run to the end; everything drawn depends on the seed.
Prints each fault with the seed of its round: `--only COMMAND --first SEED --rounds 1` repeats it. Exit code 1 where
there was any.
"""

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from torture import kills
from torture.commands import COMMANDS, Command
from torture.kills import Kill

STATE = Path("build/torture.json")
MOST = 12
"""Kills of one round."""


class Torture:
    """A command, what it leaves undisturbed, and rounds of kills."""

    def __init__(self, name: str, command: Command, scratch: Path) -> None:
        """Run the command undisturbed.

        Args:
            name: Name of the command.
            command: The command.
            scratch: Folder for its work.
        """
        self._name, self._command, self._scratch = name, command, scratch
        self.kills: Counter[str] = Counter()
        folder = self._folder()
        self._seconds = kills.finished(command, folder, f"{os.getpid()}-{name}")
        self.wanted = command.outcome(folder)
        assert self.wanted, f"{name}: leaves nothing to compare"
        folder.rename(f"{folder}-undisturbed")

    def _folder(self) -> Path:
        """A fresh folder, always of the same name: models and records say where their scene is."""
        folder = self._scratch / self._name.replace(" ", "-")
        folder.mkdir()
        self._command.prepare(folder)
        return folder

    def round(self, seed: int, most: int = MOST) -> list[str]:
        """Kill the command up to `most` times in one folder, let it end, and say what is wrong.

        Args:
            seed: On which all that is drawn depends.
            most: Bound on the kills.
        """
        draw = random.Random(f"{self._name} {seed}")
        return self.killed([kills.drawn(draw) for _ in range(draw.randint(1, most))])

    def killed(self, hows: Sequence[Kill]) -> list[str]:
        """Kill the command so and so in one folder, let it end, and say what is wrong.

        Args:
            hows: The kills, one after another.
        """
        folder, faults = self._folder(), []
        for number, how in enumerate(hows):
            mark = f"{os.getpid()}-{self._name}-{number}-{time.monotonic_ns()}"
            found = kills.kill(self._command, folder, self._seconds, how, mark, self.wanted)
            self.kills[f"{'+'.join(how.signals)} {how.whom}"] += 1
            faults += [f"kill {number} {asdict(how)}: {fault}" for fault in found]
        try:
            kills.finished(self._command, folder, f"{os.getpid()}-{self._name}-end")
            faults += kills.differences(self._command.outcome(folder), self.wanted)
            faults += [f"left over: {path}" for path in kills.left_over(folder)]
        except AssertionError as error:
            faults.append(str(error))
        if faults:
            folder.rename(f"{folder}-{time.monotonic_ns()}")
        else:
            shutil.rmtree(folder)
        return faults


def main() -> int:
    """Torture; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="of each command")
    parser.add_argument("--first", type=int, default=0, help="seed of the first round")
    parser.add_argument(
        "--only", action="append", default=[], choices=list(COMMANDS), help="a command"
    )
    parser.add_argument("--state", type=Path, default=STATE, help="file of the counts")
    given = parser.parse_args()
    scratch = Path(tempfile.mkdtemp(prefix="torture"))
    counts: dict[str, object] = {}
    failed = 0
    for name in given.only or COMMANDS:
        torture, told = Torture(name, COMMANDS[name], scratch), []
        for seed in range(given.first, given.first + given.rounds):
            faults = torture.round(seed)
            told += [f"round {seed}: {fault}" for fault in faults]
            print(
                f"{name}, round {seed}: {sum(torture.kills.values())} kills, {len(told)} faults",
                flush=True,
            )
            for fault in faults:
                print(f"    {fault}", flush=True)
            counts[name] = {
                "kills": dict(torture.kills),
                "files": len(torture.wanted),
                "faults": told,
            }
            given.state.parent.mkdir(parents=True, exist_ok=True)
            given.state.write_text(json.dumps(counts, indent=1))
        failed += len(told)
    if not failed:
        shutil.rmtree(scratch)
    else:
        print(f"folders of rounds with faults: {scratch}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
