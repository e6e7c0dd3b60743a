"""Fuzz readers by what they cover: `make fuzz-guided`, where atheris is installed (pip install atheris).

A process a reader: atheris changes the intact samples and keeps what reaches new lines of ours. The bounds and what a
reader may answer are those of every damaged file (fuzz.bounds). An input that fails is kept in build/guided and
printed. `--only NAME ...` chooses readers.
"""

import argparse
import hashlib
import importlib
import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fuzz.sanitized import ROOT, load

FOUND = ROOT / "build" / "guided"
SECONDS = 10
"""For one reader."""
LONGEST = 4096
"""Bytes of an input at the most: samples are of some hundreds."""
DONE, COVERED = re.compile(r"Done (\d+) runs"), re.compile(r" cov: (\d+)")
READERS = (
    "gaussians ply", "points ply", "packed", "packed 1", "packed 3", "packed 3 fast", "spz 3", "spz 4", "sog", "glb", "npz", "model.json", "record", "suite",
    "scene.toml", "protocol", "registry", "transforms.json", "views.json", "llff", "photo tourism", "colmap cameras.txt",
    "colmap images.txt", "colmap points3D.txt", "kitti tracklets", "kitti labels", "cameras", "baseline",
)  # fmt: skip
"""Those that are read in Python: of native code nothing is seen here (`make fuzz`)."""


def seen_by_atheris() -> None:
    """Have our modules loaded from their files: loaders of an editable install are not instrumented."""
    native = importlib.util.find_spec("splatproof._ext")
    assert native is not None
    assert native.origin is not None
    for module in [name for name in sys.modules if name.partition(".")[0] == "splatproof"]:
        del sys.modules[module]
    sys.meta_path[:] = [one for one in sys.meta_path if "editable" not in type(one).__module__]
    sys.path.insert(0, str(ROOT / "src"))
    load(Path(native.origin))


def one(name: str, seconds: int) -> None:
    """Fuzz a reader in this process, which libFuzzer ends.

    Args:
        name: Name of the target.
        seconds: For so long.
    """
    atheris = importlib.import_module("atheris")
    seen_by_atheris()
    with atheris.instrument_imports(include=["splatproof"], enable_loader_override=False):
        from fuzz.bounds import tried
        from fuzz.targets import TARGETS
    from splatproof.base.memory import MEBIBYTE, peak_memory_mb

    with tempfile.TemporaryDirectory() as folder:
        (place := Path(folder) / "place").mkdir()
        (seeds := Path(folder) / "seeds").mkdir()
        target = TARGETS[name](place)
        for number, sample in enumerate(target.samples):
            (seeds / str(number)).write_bytes(target.layout.intact(sample))
        held = peak_memory_mb() * MEBIBYTE

        def read(data: bytes) -> None:
            answer = tried(target, data, held)
            if answer.fault:
                FOUND.mkdir(parents=True, exist_ok=True)
                kept = FOUND / f"{name.replace(' ', '-')}-{hashlib.sha256(data).hexdigest()[:12]}"
                kept.write_bytes(data)
                print(json.dumps({"fault": answer.fault, "input": str(kept)}), flush=True)

        options = [f"-max_total_time={seconds}", f"-max_len={LONGEST}", "-rss_limit_mb=4096", "-verbosity=1"]  # fmt: skip
        atheris.Setup([sys.argv[0], str(seeds), *options], read)
        atheris.Fuzz()


@dataclass(frozen=True, kw_only=True)
class Read:
    """What came of a reader."""

    inputs: int
    covered: int
    """Edges of our code that some input reached."""
    faults: list[str]


def run(names: Sequence[str], seconds: int) -> dict[str, Read]:
    """What came of each reader.

    Args:
        names: Names of targets.
        seconds: For each.
    """
    found: dict[str, Read] = {}
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT / "tests")}
    for name in names:
        done = subprocess.run(
            [sys.executable, "-P", __file__, "--one", name, "--seconds", str(seconds)], env=environment,
            text=True, errors="replace", check=False, capture_output=True,
        )  # fmt: skip
        counted, covered = DONE.search(done.stderr), COVERED.findall(done.stderr)
        faults = sorted({line for line in done.stdout.splitlines() if line.startswith('{"fault"')})
        if counted is None:
            faults.append(f"ended with code {done.returncode}: {done.stderr[-300:]}")
        read = found[name] = Read(
            inputs=int(counted[1]) if counted else 0, faults=faults,
            covered=int(covered[-1]) if covered else 0,
        )  # fmt: skip
        print(
            f"{name}: {read.inputs} inputs, {read.covered} edges, {len(faults)} faults", flush=True
        )
        for fault in faults[:5]:
            print(f"  {fault}")
    return found


def main() -> None:
    """Fuzz one reader in this process, or each in its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one", help="the reader of this process")
    parser.add_argument(
        "--only", nargs="*", default=READERS, help="readers; default: those in Python"
    )
    parser.add_argument("--seconds", type=int, default=SECONDS, help="for each reader")
    told = parser.parse_args()
    if told.one:
        one(told.one, told.seconds)
    elif any(read.faults for read in run(told.only, told.seconds).values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
