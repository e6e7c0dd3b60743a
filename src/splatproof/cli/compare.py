"""`bench compare`: what got better, equal or worse between two sets of results."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from splatproof.cli import output


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
) -> int:
    """Judge every metric of NEW against BASE: better, equal, worse or undecided.

    A side is written WHERE[@COMMIT][#ROW].

    Args:
        base: What is compared with.
        new: What is judged.
        suite: Suites that are compared. Without it: all.
        metrics: Names with commas between them.
        correction: How false alarms are held down over all comparisons.
        alpha: Rate of false alarms.
        bands: File of noise bands.
        baselines: Folder where the names of saved baselines are looked up.
    """
    from splatproof.reports.comparing.bands import load_bands
    from splatproof.reports.comparing.compare import compare as compared
    from splatproof.reports.comparing.opening import open_side

    sides = [open_side(text, folder=baselines, suites=suite) for text in (base, new)]
    found = compared(
        sides[0], sides[1], alpha=alpha, correction=correction, bands=load_bands(bands),
        metrics=[name.strip() for name in metrics.split(",") if name.strip()],
    )  # fmt: skip
    for one in found.compared:
        output.print_text(f"{one.group.name} {one.measure.metric}: {one.verdict} ({one.reason})")
    return int(bool(found.regressions))
