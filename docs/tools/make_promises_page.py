"""Make docs/promises.md from the tests that hold the promises: PYTHONPATH=tests python docs/tools/make_promises_page.py"""

from pathlib import Path

from fuzz import bounds, guided, inputs
from fuzz.targets import TARGETS
from load import test_large, test_load
from splatproof.base.errors import LONGEST
from splatproof.base.memory import MEBIBYTE
from splatproof.datasets.photos import PEAK
from torture import kills
from torture.commands import COMMANDS

LARGE = "`tests/load/test_large.py`, slow"
PAGE = Path(__file__).parents[1] / "promises.md"


def bounds_table() -> str:
    """Every bound, with the number that its test asserts."""
    rows = [
        (
            "reading one damaged file: processor time", f"{bounds.SECONDS:g} s", "`tests/fuzz/bounds.py`",
        ),
        (
            "reading one damaged file: memory",
            f"{bounds.BYTES_EACH} bytes a byte of the file + {bounds.BYTES_ALWAYS // MEBIBYTE} MiB"
            + f"; of a photo also {PEAK} bytes a pixel", "`tests/fuzz/bounds.py`",
        ),
        ("an error's length", f"one line of about {LONGEST} characters", "`tests/base/test_errors.py`"),
        (
            "after a kill: no process is left", f"{kills.ORPHANS_END:g} s after the command's end",
            "`tests/torture/kills.py`",
        ),
        (
            "SIGINT or SIGTERM: the command ends", f"within {kills.ENDS:g} s", "`tests/torture/kills.py`",
        ),
        (
            f"a suite of {test_load.CASES:,} cases: planned in", f"{test_load.SECONDS:g} s of processor time",
            "`tests/load/test_load.py`",
        ),
        (
            f"{test_large.VIEWS:,} photos of 4000 x 3000: opened, and {test_large.STEPS} steps at their full size",
            f"{test_large.VIEWS_MB} MiB", LARGE,
        ),
        (
            f"{test_large.BLOCK * test_large.BLOCKS:,} Gaussians of degree 3 in {test_large.BLOCKS} blocks: merged and "
            + "packed", f"{test_large.MERGED_MB} MiB", LARGE,
        ),
        (
            f"`bench report` of a store with {test_large.RESULTS:,} results", f"{test_large.RESULTS_MB} MiB",
            LARGE,
        ),
        (
            "training, saving, loading and drawing again and again for 20 minutes",
            f"grows by less than {test_large.GROWTH_MB:g} MiB in the second half", LARGE,
        ),
        ("what listens: pages, workers, a Ray cluster that we start", "the loopback address",
         "`tests/reliability/test_listening.py`"),
    ]  # fmt: skip
    lines = ["| what | bound | asserted in |", "| --- | --- | --- |"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def page() -> str:
    """The page."""
    commands = "\n".join(f"- `bench {' '.join(one.arguments)}`" for one in COMMANDS.values())
    signals = ", ".join(
        dict.fromkeys(" twice ".join((s[0], "")[: len(s)]).strip() for s in kills.SIGNALS)
    )
    files = ", ".join(sorted(TARGETS))
    return f"""# Promises

What splatproof promises of durability, of sameness and of bounds, how each promise is tested, and what is not
promised. The numbers are those that the tests assert; this page is made from them by
`docs/tools/make_promises_page.py`.

## Durability

A command that is killed at any moment is started again with the same words and ends as if nothing had happened:
records (apart from what clocks and machines say), model bytes, pictures and the store's rows equal those of an
undisturbed run. A file under its final name is whole, and nothing half-made is left at the end.

`make torture` holds these commands against it, with {signals} to the process, its group or one of its workers,
at moments drawn from a seed:

{commands}

Two kills are part of `make test` (`tests/torture/test_torture.py`), which also plants a fault of each kind and sees
that it is found.

## Sameness

The same seed on the same machine gives the same bits on the CPU, for any number of threads
(`tests/methods/test_same_bytes.py`, `tests/datasets/ingesting/test_ingest.py`).

## Damaged files

Every reader answers a damaged file with an error of one line that names it, or with numbers that are finite; never
with a traceback. `make fuzz-inputs` feeds {inputs.WHOLE:,} damaged files to the readers of {files}: bytes, text
and trees are changed, and lengths and checksums are made right again, so that what lies behind them is tried too.
`make test` feeds the first 20,000 and all that ever failed (`tests/fuzz/corpus`, with the reasons).
`make fuzz-guided` changes the files of {len(guided.READERS)} readers by what they cover (atheris). `make fuzz` calls
the native layer with odd arrays under AddressSanitizer and UndefinedBehaviorSanitizer, and from two Python threads at
once, each on several of the pool's, under ThreadSanitizer (`tests/fuzz/test_sanitized.py`, slow, with a race that is
planted).

## Bounds

{bounds_table()}

## Not promised

- The same bits on another machine, another version of torch or another SIMD level: results then agree within the
  budgets of [performance](performance.md).
- Resuming a study: it starts over, but for the speed study, which goes on after the last whole case.
- What a full disk, a broken memory or a network file system without locks does to files.
- Hashes in `make setup`: the files that are locked (`make setup-locked`) hold torch's CPU build, which PyPI does not have,
  and all extras. On a machine that asks PyPI alone it could never apply, so `make setup` does not try.
- Safety against plug-ins: they are Python that you run.
"""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
