"""Fuzz every reader of files with damaged input: `make fuzz-inputs`, a part of it in the tests.

An input is made from its target's name and its number alone, so a finding is repeated by
`--only TARGET --first NUMBER --inputs 1`. A second process reads them under bounds of time and memory
(bounds.py); one that dies or hangs is a finding too. Counts and findings are kept in the state folder, and a
run that was ended goes on where it was. Exit code 1 where anything was found.
"""

import argparse
import json
import re
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from fuzz.reading import Reader
from fuzz.serving import made_targets, scratch_folder
from fuzz.target import slug
from fuzz.targets import TARGETS

STATE = Path("build/fuzz")
WHOLE = 1_000_000
"""Inputs of a full run."""
BATCH = 200
"""Inputs between two looks at another target: a run that is ended early has tried all."""
SHARES = {
    "blender": 0.02, "tar.gz": 0.1, "baseline": 0.1, "transforms.json": 0.1, "llff": 0.1,
    "model.json": 0.1, "tar": 0.15, "suite": 0.15, "exif": 0.2, "cameras": 0.1, "zip": 0.3,
    "model.safetensors": 0.2, "colmap rigs.txt": 0.1, "colmap frames.txt": 0.1, "record": 0.3,
    "colmap cameras.txt": 0.3, "colmap images.txt": 0.3, "colmap points3D.txt": 0.3,
    "sog": 0.2, "gaussians ply": 0.5, "packed": 0.5, "packed 3": 0.5, "packed 3 fast": 0.5, "protocol": 0.5, "registry": 0.3, "points ply": 1.5,
    "npz": 1.5, "views.json": 1.5, "kitti labels": 1.5, "kitti tracklets": 1.5, "photo tourism": 1.5,
}  # fmt: skip
"""Inputs of a target against others', by what one costs; the rest have 1."""


@dataclass(kw_only=True)
class Count:
    """What was done of a target."""

    done: int = 0
    accepted: int = 0
    seconds: float = 0.0
    faults: int = 0
    kinds: dict[str, list[str]] = field(default_factory=dict)
    """Kind of fault: number of the first input that has it, and what was said."""


def goals(inputs: int, only: list[str]) -> dict[str, int]:
    """Inputs of each target.

    Args:
        inputs: In all.
        only: Names of targets; empty: all.
    """
    shares = {name: SHARES.get(name, 1.0) for name in only or TARGETS}
    whole = sum(shares.values())
    return {name: round(inputs * share / whole) for name, share in shares.items()}


def kind_of(fault: str) -> str:
    """A fault without what differs from input to input.

    Args:
        fault: What is wrong.
    """
    return re.sub(r"'[^']*'|\"[^\"]*\"|/\S+|[\d.]+", "#", fault)[:70]


def run(counts: dict[str, Count], goal: Mapping[str, int], folder: Path, *, first: int = 0) -> None:
    """Have inputs read until every target has had its share; counts are written after each batch.

    Args:
        counts: What was done so far; changed.
        goal: Inputs of each target.
        folder: State folder.
        first: Number of a target's first input.
    """
    with Reader(folder) as reader:
        while left := {name for name, most in goal.items() if counts[name].done < most}:
            for name in sorted(left):
                count = counts[name]
                batch = reader.read(name, first + count.done, min(BATCH, goal[name] - count.done))
                count.done += batch.done
                count.accepted += batch.accepted
                count.seconds += batch.seconds
                count.faults += len(batch.faults)
                for number, fault in batch.faults.items():
                    count.kinds.setdefault(kind_of(fault), [str(number), fault])
                write(counts, folder)


def write(counts: Mapping[str, Count], folder: Path) -> None:
    """Keep the counts.

    Args:
        counts: Those of each target.
        folder: State folder.
    """
    text = json.dumps({name: asdict(count) for name, count in counts.items()}, indent=1)
    (folder / "counts.partial").write_text(text)
    (folder / "counts.partial").rename(folder / "counts.json")


def read(folder: Path) -> dict[str, Count]:
    """The counts of a run that was ended, or of none.

    Args:
        folder: State folder.
    """
    path = folder / "counts.json"
    kept = json.loads(path.read_text()) if path.exists() else {}
    return {name: Count(**kept.get(name, {})) for name in TARGETS}


def table(counts: Mapping[str, Count]) -> str:
    """The counts and the kinds of faults as text.

    Args:
        counts: Those of each target.
    """
    lines = [f"{'target':24}{'inputs':>9}{'accepted':>10}{'ms each':>9}{'faults':>8}"]
    for name, count in counts.items():
        if count.done:
            each = 1000 * count.seconds / count.done
            lines.append(f"{name:24}{count.done:9}{count.accepted:10}{each:9.2f}{count.faults:8}")
            lines += [f"    {number}: {fault}" for number, fault in count.kinds.values()]
    total, faults = (sum(getattr(c, key) for c in counts.values()) for key in ("done", "faults"))
    return "\n".join([*lines, f"{total} inputs, {faults} faults"])


def keep_findings(counts: Mapping[str, Count], folder: Path) -> None:
    """Write the first input of each kind of fault as a file.

    Args:
        counts: Those of each target.
        folder: State folder.
    """
    with scratch_folder() as scratch:
        targets = made_targets(Path(scratch), TARGETS)
        for name, count in counts.items():
            for number, _ in count.kinds.values():
                path = folder / "findings" / slug(name) / f"{number}{targets[name].path.suffix}"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(targets[name].input(name, int(number)))


def main() -> int:
    """Fuzz; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=WHOLE)
    parser.add_argument("--first", type=int, default=0, help="number of each target's first input")
    parser.add_argument(
        "--only", action="append", default=[], choices=list(TARGETS), help="a target"
    )
    parser.add_argument("--state", type=Path, default=STATE, help="folder of counts and findings")
    given = parser.parse_args()
    counts, begun = read(given.state), time.monotonic()
    run(counts, goals(given.inputs, given.only), given.state, first=given.first)
    print(table(counts))
    print(f"{time.monotonic() - begun:.0f} s")
    keep_findings(counts, given.state)
    return int(any(count.faults for count in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
