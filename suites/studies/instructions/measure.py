"""`bench study instructions`: instructions of fixed kernel work, which repeat where seconds do not."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from splatproof.base.errors import MissingError, SplatproofError

Row = dict[str, Any]
SCRIPT = Path(__file__).with_name("workloads.py")
MARK = "getppid"
"""Function of the C library whose calls part the pieces of work; nothing else calls it."""
LEVELS = ("avx2", "portable")
"""SIMD levels that are counted, best first: valgrind runs no AVX-512, so it is never chosen."""
BASELINE = Path("baselines/instructions.jsonl")
"""Rows of an earlier `bench study instructions --out baselines`, relative to the working folder."""
BAND = 0.01
"""Share by which a piece may take more instructions than the baseline's. Two runs of one build count the
same to the last instruction; another C library or Python changes allocation and the call from Python, which
were below 0.2 % of the smallest piece."""
UNITS = {"gaussians": "per_gaussian", "pairs": "per_pair", "pixels": "per_pixel", "anchors": "per_anchor"}  # fmt: skip
"""Columns of what a piece of work takes by what it works on."""
TIMEOUT_SECONDS = 900


def rows(*, quick: bool) -> Iterator[Row]:
    """One row a piece of work, of one thread at the SIMD level that it names.

    Keys: workload, instructions, per_gaussian, per_pair, per_pixel, per_anchor (of what it works on), simd,
    compiler, repeats (largest share by which a second process differed), change (share by which it
    differs from the baseline's, where that was counted of the same compiler and level), ok, note.

    Args:
        quick: Count once, and leave out `repeats`.

    Raises: MissingError where valgrind is not installed.
    """
    baseline = read_baseline(BASELINE)
    counted = count_pieces()
    again = counted if quick else count_pieces()
    for row, other in zip(counted, again, strict=True):
        found = row if quick else row | {"repeats": differs(other, row)}
        yield found | judged(found, baseline)


def judged(row: Mapping[str, Any], baseline: Sequence[Mapping[str, Any]]) -> Row:
    """What the baseline says of a row: change, ok and note.

    Args:
        row: A piece of work, counted now.
        baseline: Rows of the baseline; empty: there is none.
    """
    same = [old for old in baseline if all(old.get(k) == row[k] for k in ("workload", "simd", "compiler"))]  # fmt: skip
    if not same:
        return {"ok": True, "note": "no baseline of this work, compiler and SIMD level"}
    before = same[0]["instructions"]
    worse = row["instructions"] > (1 + BAND) * before
    note = f"more than {BAND:.0%} above the baseline's {before:,}" if worse else ""
    return {"change": row["instructions"] / before - 1, "ok": not worse, "note": note}


def differs(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Share by which two counts of one piece differ.

    Args:
        one: Row of one process.
        other: Row of another.
    """
    return abs(one["instructions"] / other["instructions"] - 1)


def read_baseline(path: Path) -> list[Row]:
    """Rows of a baseline; none where there is no such file.

    Args:
        path: File of JSON lines, as `bench study` writes it.
    """
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def count_pieces() -> list[Row]:
    """Run every piece of `workloads.py` under callgrind in a process with a fixed environment.

    Returns: A row a piece, with instructions, what it worked on, SIMD level and compiler.
    Raises: MissingError where valgrind is not installed; SplatproofError if it fails, or runs longer
        than TIMEOUT_SECONDS.
    """
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        raise MissingError(
            "valgrind is not installed; it counts instructions (apt-get install valgrind)"
        )
    from splatproof import _ext

    level = next(level for level in LEVELS if level in _ext.simd_levels())
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out")
        command = [
            valgrind, "--tool=callgrind", f"--callgrind-out-file={out}", f"--dump-before={MARK}",
            sys.executable, "-s", "-S", "-P", str(SCRIPT), _ext.__file__,
        ]  # fmt: skip
        environment = {
            "PATH": os.defpath, "PYTHONHASHSEED": "0", "SPLATPROOF_SIMD": level, "LC_ALL": "C",
            "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=True,
                timeout=TIMEOUT_SECONDS,
            )  # fmt: skip
        except subprocess.CalledProcessError as error:
            lines = (error.stderr or "").strip().splitlines()
            raise SplatproofError(f"valgrind failed: {lines[-1] if lines else error}") from error
        except subprocess.TimeoutExpired as error:
            raise SplatproofError(f"valgrind ran for more than {TIMEOUT_SECONDS} s") from error
        facts, *pieces = map(json.loads, done.stdout.splitlines())
        counts = read_counts(out, len(pieces))
    return [row_of(piece, count, facts) for piece, count in zip(pieces, counts, strict=True)]


def row_of(piece: Mapping[str, Any], instructions: int, facts: Mapping[str, str]) -> Row:
    """A piece of work and what it takes.

    Args:
        piece: What the script said: the name, and the numbers of what was worked on.
        instructions: What callgrind counted.
        facts: SIMD level and compiler.
    """
    each = {UNITS[k]: instructions / n for k, n in piece.items() if k in UNITS}
    return {"workload": piece["workload"], "instructions": instructions, **each, **facts}


def read_counts(out: Path, pieces: int) -> list[int]:
    """Instructions between the marks of each piece.

    The dump <out>.1 holds what came before the first mark, <out>.2 the first piece, <out>.3 what came
    between it and the second, and so on; <out> itself the end.

    Args:
        out: What callgrind was told to write to.
        pieces: Number of pieces.
    Raises: SplatproofError where the dumps are other than that many pieces leave.
    """
    dumps = [out.with_name(f"{out.name}.{i}") for i in range(1, 2 * pieces + 1)]
    if not all(dump.is_file() for dump in dumps) or dumps[-1].with_suffix(f".{len(dumps) + 1}").exists():  # fmt: skip
        raise SplatproofError(
            f"callgrind left {len(list(out.parent.iterdir())) - 1} dumps, expected {len(dumps)}; is "
            f"{MARK} called by others in this Python?"
        )
    return [_total(dump) for dump in dumps[1::2]]


def _total(dump: Path) -> int:
    """The number behind "totals:" of a callgrind dump."""
    for line in dump.read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("totals:"):
            return int(line.split()[1])
    raise SplatproofError(f"{dump.name}: no totals; the count is not whole")
