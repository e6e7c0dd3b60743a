"""From the runs of a suite to the committed files behind its page, and from these to the page."""

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import fmean

from comparison_page import Page, compared_row, render_page
from kept_rows import Picture, committed, joined, pictures_of
from matplotlib.axes import Axes
from PIL import Image
from printed_tables import Printed
from strips import crops, file_name, save_strips

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.reference.types.result import Result
from splatproof.reports.claims.claim import load_claims
from splatproof.reports.measured import COUNT, Measured, loss_points, measured
from splatproof.suites.gallery.drawing import COLOURS, panels, save
from splatproof.suites.held_out import scored_views
from splatproof.suites.published.rows import numbers
from splatproof.suites.records import read_record
from splatproof.suites.suite_files import Case, load_suite

DOCS = Path(__file__).parents[1]
CURVES = "Training loss and number of stored primitives (Gaussians, or anchors of several each)"
"""What a picture of curves shows."""
COLOURS_KEPT = 128
"""Colours that such a picture is kept in."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What one page compares."""

    suite: str
    title: str
    intro: str
    printed: tuple[Printed, ...]
    protocol: str
    """Protocol whose pictures are shown."""
    scene: str
    """Scene whose pictures are shown."""
    units: str = "held-out views"
    """What a strip shows, in captions."""
    earlier: Mapping[str, object] = field(default_factory=dict)
    """Defaults of before, by dotted names, that committed rows may have: they make no difference to them."""


def main(comparison: Comparison) -> None:
    """With a folder of runs on the command line: rows, pictures and page; else the page alone."""
    if len(sys.argv) > 1:
        collect(comparison, Path(sys.argv[1]), DOCS)
    (DOCS / f"{comparison.suite}.md").write_text(page(comparison, DOCS), encoding="utf-8")


def page(comparison: Comparison, docs: Path) -> str:
    """The page from the committed files.

    Args:
        comparison: Which page.
        docs: Folder with <suite>.json, <suite>_pictures.json and <suite>_findings.md.
    """
    name = comparison.suite
    rows = json.loads((docs / f"{name}.json").read_text(encoding="utf-8"))
    pictures = json.loads((docs / f"{name}_pictures.json").read_text(encoding="utf-8"))
    return render_page(
        Page(
            suite=name,
            title=comparison.title,
            intro=comparison.intro,
            planned=planned(load_suite(name).cases),
            rows=[Measured(**row) for row in rows],
            claims=load_claims(name, numbers()),
            printed=comparison.printed,
            findings=(docs / f"{name}_findings.md").read_text(encoding="utf-8"),
        ),
        [Picture(**entry) for entry in pictures],
    )


def planned(cases: Sequence[Case]) -> Mapping[tuple[str, str, str], int]:
    """Seeds by scene, protocol and row, in the suite's order."""
    return Counter((case.scene_name, case.protocol.name, case.row) for case in cases)


def collect(comparison: Comparison, runs: Path, docs: Path) -> None:
    """Write the committed files of a page from the records and pictures of a suite's runs.

    Rows and pictures of cases that the runs lack are kept as they were committed, see `joined`.

    Args:
        comparison: Which page.
        runs: Folder that `bench run SUITE --out` was given.
        docs: Folder of the page.
    """
    name = comparison.suite
    cases = [
        (case, runs / name / case.folder)
        for case in load_suite(name).cases
        if (runs / name / case.folder / "record.json").exists()
    ]
    found = [(case, folder, read_record(folder)) for case, folder in cases]
    claims = load_claims(name, numbers())
    judged = {claim.metric for claim in claims}
    new = [asdict(_with_images_of(measured(result), judged)) for _, _, result in found]
    old = committed(docs / f"{name}.json")
    rows, kept = joined(new, old, load_suite(name).cases, comparison.earlier)
    places = [{(row["scene"], row["protocol"], row["row"]) for row in each} for each in (old, rows)]
    for place in sorted(places[0] - places[1]):
        print(
            f"{name}: {'/'.join(place)} is dropped: the suite has it no longer, or other settings",
            file=sys.stderr,
        )
    text = "[\n" + ",\n".join(json.dumps(row, allow_nan=False) for row in rows) + "\n]\n"
    (docs / f"{name}.json").write_text(text, encoding="utf-8")
    shown = [
        (case, folder, result) for case, folder, result in found
        if (case.scene_name, case.protocol.name) == (comparison.scene, comparison.protocol)
        and not result.error
        and case.seed == 0 and compared_row(case.row, claims)
    ]  # fmt: skip
    curves = _curves(shown, name, docs, later=bool(kept))
    listing = docs / f"{name}_pictures.json"
    before = [Picture(**entry) for entry in committed(listing)] if kept else []
    pictures = pictures_of([*curves, *_strips(shown, comparison, docs)], before, rows)
    text = json.dumps([asdict(one) for one in pictures], indent=1) + "\n"
    listing.write_text(text, encoding="utf-8")


def _with_images_of(row: Measured, judged: set[str]) -> Measured:
    """The row with those metrics of images alone that a claim is judged by."""
    images = {
        name: {metric: value for metric, value in scores.items() if metric in judged}
        for name, scores in row.images.items()
    }
    return replace(row, images=images)


Shown = Sequence[tuple[Case, Path, Result]]


def _strips(shown: Shown, comparison: Comparison, docs: Path) -> list[Picture]:
    """A strip a row; all of one scene show the same parts of the same views."""
    made = []
    for scene in dict.fromkeys(case.scene_name for case, _, _ in shown):
        own = [(case, folder) for case, folder, _ in shown if case.scene_name == scene]
        case = own[0][0]
        views = scored_views(open_scene(case.scene, case.protocol), case.protocol)
        folders = {case.row: folder for case, folder in own}
        images = docs / "images" / comparison.suite
        for row, path in save_strips(folders, crops(views), images).items():
            caption = (f"{row}, {scene}: {comparison.units} it never saw; photo, render, FLIP error "
                       "(black: none). Seed 0.")  # fmt: skip
            made.append(Picture(path=path.relative_to(docs).as_posix(), caption=caption, row=row))
    return made


def _curves(shown: Shown, name: str, docs: Path, *, later: bool) -> list[Picture]:
    """Loss and number of stored primitives over the steps, a line a row that was run now.

    What is run later gets a picture of its own, named after its first row, so that the curves of rows
    that were run before stay on the page.
    """
    drawn = [(case.row, result.curve) for case, _, result in shown if result.curve]
    if not drawn:
        return []
    figure, (losses, counts) = panels(2, width=12.0, ratio=0.65)
    for number, (row, curve) in enumerate(drawn):
        line = {"color": COLOURS[number % len(COLOURS)], "linewidth": 1.0,
                "linestyle": ("-", "--", ":")[number // len(COLOURS) % 3], "label": row}  # fmt: skip
        points = loss_points(curve)
        losses.plot([step for step, _ in points], _smooth([loss for _, loss in points]), **line)
        grown = [(step, values[COUNT]) for step, values in curve if COUNT in values]
        counts.plot([step for step, _ in grown], [count for _, count in grown], **line)
    _titled(losses, "training loss, mean of 10 points")
    _titled(counts, "stored primitives")
    counts.legend(fontsize=6, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    stem = f"curves_{file_name(drawn[0][0])}" if later else "curves"
    path = docs / "images" / name / f"{stem}.png"
    save(figure, path)
    # lines have few colours: less than a third of the bytes
    with Image.open(path) as whole:
        few = whole.convert("RGB").quantize(COLOURS_KEPT)
    few.save(path, optimize=True)
    which = f", of {', '.join(row for row, _ in drawn)}" if later else ""
    return [Picture(path=path.relative_to(docs).as_posix(),
                    caption=f"{CURVES} over the steps{which}, seed 0.")]  # fmt: skip


def _titled(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("step", fontsize=8)
    axes.set_yscale("log")
    axes.tick_params(labelsize=7)


def _smooth(values: Sequence[float], over: int = 10) -> list[float]:
    """Mean of each value and the `over` - 1 before it, as far as there are any."""
    return [fmean(values[max(0, i + 1 - over) : i + 1]) for i in range(len(values))]
