"""`bench compare`: what got better, equal or worse between two sets of results."""

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from splatproof.base.errors import UsageError
from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.reports.comparing.aggregates import Aggregate
    from splatproof.reports.comparing.compare import Comparison

PIPED_WIDTH = 200
"""Characters a line where stdout is no terminal."""
SEED = 0
"""Seed of the draws for whole suites, so that the same results give the same numbers."""


def compare(
    base: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="BASE")],
    new: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NEW")],
    *,
    suite: tuple[str, ...] = (),
    metrics: str = "",
    correction: Literal["holm", "benjamini-hochberg"] = "holm",
    alpha: float = 0.05,
    bands: Path | None = None,
    baselines: Path = Path("baselines"),
    complete: bool = False,
    markdown: Path | None = None,
) -> int:
    """Judge every metric of NEW against BASE: better, equal, worse or undecided.

    A side is written WHERE[@COMMIT][#ROW]. WHERE: a folder of runs, an MLflow store (FILE.db or a URI), a
    baseline file, or the name of a saved baseline. @COMMIT: its results of one commit, of which four
    digits or more are given; needs the store, which keeps older results. #ROW: one row of tables.

        bench compare quick runs               a saved baseline against a folder of runs
        bench compare old/runs new/runs        two folders
        bench compare runs#3dgs runs#3dgs@affine      two rows of one folder
        bench compare runs@0123abc runs@89abcde       two commits in one store
        bench compare http://host:5000/@0123abc runs  a server's results of a commit

    Worse or better: the interval of NEW - BASE over images and seeds excludes 0 after correction for all
    comparisons of the run, and the mean lies beyond the metric's declared noise band. Equal: the 95 %
    interval lies inside the band, or both are the same bits. Else undecided, with the smallest difference
    that these runs would have shown. Times and memory are judged only between runs that took turns on one
    machine. Exit code 1: something got worse, a case fails that did not, or, with --complete, is gone or not comparable. With --json each line is an
    object with "kind": comparison, aggregate, failure, not comparable, counter, differing,
    summary.

    Args:
        base: What is compared with.
        new: What is judged.
        suite: Suites that are compared. Without it: all.
        metrics: Names with commas between them, e.g. psnr,flip. Without it: those of the protocols and
            those with a declared noise band.
        correction: holm: the chance of any false alarm is at most ALPHA; benjamini-hochberg: the share
            of false alarms among all is, on average.
        alpha: Rate of false alarms.
        bands: TOML file of noise bands ([bands.psnr] with unit, value, measured, command) that replace
            or add to the declared ones; `bench baseline bands` measures them.
        baselines: Folder where the names of saved baselines are looked up.
        complete: Also end with 1 where NEW lacks a case, a seed or a metric that BASE has, or has it by
            other rules or of other photos; without it they are listed, since NEW may be a part on purpose.
        markdown: Also write a report for a pull request to this file, with its pictures in a folder
            beside it.
    """
    import numpy as np

    from splatproof.reports.comparing.aggregates import aggregate
    from splatproof.reports.comparing.bands import load_bands
    from splatproof.reports.comparing.compare import compare as compared
    from splatproof.reports.comparing.opening import open_side
    from splatproof.reports.comparing.terminal import records, terminal

    if not 0 < alpha < 1:
        raise UsageError(f"--alpha {alpha:g}: expected a rate between 0 and 1, e.g. 0.05")
    sides = [open_side(text, folder=baselines, suites=suite) for text in (base, new)]
    names = [name.strip() for name in metrics.split(",") if name.strip()]
    found = compared(
        sides[0], sides[1], alpha=alpha, correction=correction, metrics=names,
        bands=load_bands(bands),
    )  # fmt: skip
    aggregates = aggregate(found, np.random.default_rng(SEED), names)
    if markdown:
        _write(markdown, found, aggregates)
    if output.wants_json():
        for record in records(found, aggregates):
            output.print_record(record)
    else:
        width = None if sys.stdout.isatty() else PIPED_WIDTH
        Console(width=width, highlight=False).print(terminal(found, aggregates))
    if not found.judged and not found.failures:
        what = "metric of a case" if found.compared or found.not_judged else "case"
        raise UsageError(f"{base} and {new} have no {what} in common that can be compared")
    gone = found.gone if complete else ()
    if gone:
        output.log(
            f"--complete: NEW lacks {len(gone)} of BASE's, or cannot be compared there: {', '.join(gone)}"
        )
    return int(bool(found.regressions or gone))


def _write(path: Path, found: "Comparison", aggregates: "list[Aggregate]") -> None:
    """Write the report and its pictures, which lie in a folder of its own name beside it."""
    from splatproof.base.files import write_bytes, write_text
    from splatproof.reports.comparing.crops import changed_views, draw
    from splatproof.reports.comparing.markdown import markdown
    from splatproof.reports.comparing.profile_picture import draw_profile

    folder = path.with_name(f"{path.stem}_pictures")
    pictures: list[tuple[str, bytes]] = []
    for view in changed_views(found):
        drawn = draw(view)
        if isinstance(drawn, str):
            output.log(f"no crops: {drawn}")
            break
        pictures.append((view.title, drawn))
    pictures += [
        (
            f"profile of {one.measure.metric} in {one.suite}/{one.protocol}, {one.row}",
            draw_profile(one),
        )
        for one in aggregates
    ]
    linked = []
    for number, (title, png) in enumerate(pictures, start=1):
        plain = re.sub(r"[^a-zA-Z0-9.]+", "-", title.split(":")[0].removesuffix(".png")).strip("-")
        name = f"{number:02d}-{plain}.png"
        write_bytes(folder / name, png)
        linked.append((title, f"{folder.name}/{name}"))
    write_text(path, markdown(found, aggregates, linked))
    output.log(f"report: {path}")
