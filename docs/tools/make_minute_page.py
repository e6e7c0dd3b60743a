"""Make docs/minute.md: python docs/tools/make_minute_page.py RUNS

Reads the records of `bench run minute --out RUNS` and writes docs/minute.json, docs/images/minute/ and the
page, with docs/minute_findings.md in it, which is written by hand. Rows that RUNS lack are kept as they were
committed; without RUNS the page is made again from the committed files.
"""

import itertools
import json
import math
import statistics
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from kept_rows import committed, joined
from matplotlib.ticker import NullFormatter
from strips import crops, save_strips

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.reading_clock import PARTS
from splatproof.metrics.scene_registry import MARKS
from splatproof.reference.types.result import Result
from splatproof.reports.statistics import Summary, summarise
from splatproof.suites.gallery.drawing import COLOURS, panels, save
from splatproof.suites.held_out import scored_views
from splatproof.suites.records import read_record
from splatproof.suites.suite_files import Case, load_suite

DOCS = Path(__file__).parents[1]
SUITE = "minute"
RIVAL = "3dgs@hand"
"""The row that auto is measured against: settings chosen by hand."""
MACHINE = ("cpu", "cores", "simd", "threads")


@dataclass(frozen=True, kw_only=True)
class Row:
    """What the page keeps of a record."""

    scene: str
    protocol: str
    row: str
    seed: int
    timed: tuple[tuple[float, dict[str, float]], ...]
    """(seconds, mean of each metric) at each mark."""
    final: dict[str, float]
    """Mean of each metric of the final model."""
    primitives: int
    stages: dict[str, float]
    total: float
    """Wall seconds until the model was trained, opening of the scene included."""
    machine: str
    plan: dict[str, str]
    """What method auto chose, and why."""
    reading: dict[str, float] = field(default_factory=dict)
    """Seconds that threads read photos beside the training, by part; empty: not counted."""


def row_of(result: Result) -> Row:
    """What is kept of a record.

    Args:
        result: A finished case with marks.
    """
    plan = {
        name.removeprefix("plan: "): text
        for name, text in result.environment.items()
        if name.startswith("plan: ")
    }
    names = {name for _, means in result.timed for name in means}
    return Row(
        scene=result.scene, protocol=result.protocol, row=result.row, seed=result.seed,
        timed=result.timed, final={name: result.metrics[name] for name in sorted(names)},
        primitives=result.primitives, stages=result.stages,
        total=result.stages["load"] + (result.curve_seconds[-1] if result.curve_seconds else math.nan),
        machine=", ".join(f"{name} {result.environment.get(name, '')}" for name in MACHINE), plan=plan,
        reading={part: result.metrics[f"{part}_seconds"] for part in PARTS if f"{part}_seconds" in result.metrics},
    )  # fmt: skip


def collect(runs: Path, docs: Path) -> None:
    """Write minute.json and the pictures from the records of a suite's runs; rows that the runs lack are kept, see `joined`.

    Args:
        runs: Folder that `bench run minute --out` was given.
        docs: Folder of the page.
    """
    cases = [
        (case, runs / SUITE / case.folder)
        for case in load_suite(SUITE).cases
        if (runs / SUITE / case.folder / "record.json").exists()
    ]
    new = [
        asdict(row_of(result))
        for _, folder in cases
        if not (result := read_record(folder)).error and result.timed
    ]
    kept = docs / f"{SUITE}.json"
    held, _ = joined(new, committed(kept), load_suite(SUITE).cases)
    kept.write_text("[\n" + ",\n".join(map(json.dumps, held)) + "\n]\n", encoding="utf-8")
    rows = [Row(**row) for row in held]
    for scene, protocol in places(rows):
        curves([row for row in rows if (row.scene, row.protocol) == (scene, protocol)], docs)
        strips(
            [(c, f) for c, f in cases if (c.scene_name, c.protocol.name) == (scene, protocol)], docs
        )


def places(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Scene and protocol of the rows, in their order."""
    return list(dict.fromkeys((row.scene, row.protocol) for row in rows))


def curves(rows: Sequence[Row], docs: Path) -> None:
    """PSNR over wall seconds, a line a seed, of one scene.

    Args:
        rows: Rows of one scene and protocol.
        docs: Folder of the page.
    """
    figure, (axes,) = panels(1, width=8.0, ratio=0.55)
    names = list(dict.fromkeys(row.row for row in rows))
    for row in rows:
        number = names.index(row.row)
        style = {"color": COLOURS[number % len(COLOURS)], "linewidth": 1.2,
                 "linestyle": ("-", "--", ":")[number // len(COLOURS) % 3]}  # fmt: skip
        points = [(seconds, means["psnr"]) for seconds, means in row.timed]
        if row.total > points[-1][0]:
            points.append((row.total, row.final["psnr"]))
        axes.plot(*zip(*points, strict=True), **style, marker="o", markersize=2.5,
                  label=row.row if row.seed == min(r.seed for r in rows) else None)  # fmt: skip
    axes.set_xscale("log")
    axes.xaxis.set_minor_formatter(NullFormatter())
    last = max(row.total for row in rows)
    ticks = [5, 10, 20, 30, 60, *(late for late in (120, 300, 600) if late < last)]
    axes.set_xticks(ticks, labels=[str(tick) for tick in ticks])
    axes.set_xlabel("wall seconds since the scene was opened", fontsize=8)
    axes.set_ylabel("PSNR of held-out views, dB", fontsize=8)
    axes.set_title(f"{rows[0].scene}, {rows[0].protocol}: a line a seed", fontsize=9)
    axes.grid(alpha=0.3)
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, docs / "images" / SUITE / f"{rows[0].scene}.png")


def strips(cases: Sequence[tuple[Case, Path]], docs: Path) -> None:
    """Photo, final render and error of held-out views, a strip a row, of one scene and seed 0."""
    shown = [(case, folder) for case, folder in cases if case.seed == 0]
    if shown:
        case = shown[0][0]
        views = scored_views(open_scene(case.scene, case.protocol), case.protocol)
        folders = {f"{case.scene_name} {case.row}": folder for case, folder in shown}
        save_strips(folders, crops(views), docs / "images" / SUITE)


def page(docs: Path) -> str:
    """The page from the committed files.

    Args:
        docs: Folder with minute.json, minute_findings.md and images/minute/.
    """
    stored = json.loads((docs / f"{SUITE}.json").read_text(encoding="utf-8"))
    rows = [
        Row(**(row | {"timed": tuple((s, means) for s, means in row["timed"])})) for row in stored
    ]
    asked = Counter((c.scene_name, c.protocol.name, c.row) for c in load_suite(SUITE).cases)
    done = Counter((row.scene, row.protocol, row.row) for row in rows)
    lacking = sum(done[key] < count for key, count in asked.items())
    parts = [
        HEAD.format(machines="; ".join(sorted({row.machine for row in rows})) or "nothing yet"),
        f"**Incomplete**: {lacking} of {len(asked)} rows (a scene each) have fewer seeds than the suite asks "
        "for.\n" if lacking else f"All {len(asked)} rows of the suite are here.\n",
        (docs / f"{SUITE}_findings.md").read_text(encoding="utf-8").rstrip() + "\n",
    ]  # fmt: skip
    for scene, protocol in places(rows):
        own = [row for row in rows if (row.scene, row.protocol) == (scene, protocol)]
        parts += [
            f"## {scene}, protocol {protocol}\n",
            table(own),
            parts_of_time(own),
            duel(own),
            planned(own),
        ]
        images = docs / "images" / SUITE
        for path in (images / f"{scene}.png", *sorted(images.glob(f"{scene}[- _]*.jpg"))):
            if path.exists():
                parts.append(f"![{path.stem}]({path.relative_to(docs).as_posix()})\n")
    return "\n".join(part for part in parts if part).rstrip() + "\n"


def table(rows: Sequence[Row]) -> str:
    """A line a row of the suite: scores at the marks, seconds, Gaussians."""
    marks = "".join(f" PSNR {mark} s |" for mark in MARKS)
    lines = [
        (
            f"| row | seeds |{marks} SSIM {MARKS[-1]} s | FLIP {MARKS[-1]} s | final PSNR | reached after s | to "
            "95 % s | before the first step s | Gaussians |"
        ),
        "|---|---:|" + "---:|" * (len(MARKS) + 7),
    ]
    for name in dict.fromkeys(row.row for row in rows):
        own = [row for row in rows if row.row == name]
        cells = [spread([at(row, "psnr", mark) for row in own], 2) for mark in MARKS]
        cells += [
            spread([at(row, metric, MARKS[-1]) for row in own], 3)
            for metric in ("ssim_3dgs", "flip")
        ]
        cells += [
            spread([row.final["psnr"] for row in own], 2), spread([row.total for row in own], 0),
            spread([row.final.get("time_to_95", to_95(row)) for row in own], 1),
            spread([before(row) for row in own], 1),
            f"{statistics.fmean(row.primitives for row in own):,.0f}",
        ]  # fmt: skip
        lines.append(f"| {name} | {len(own)} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


STAGES = ("load", "plan", "init", "train")
"""Stages of a case until its model is trained, one after the other."""


def parts_of_time(rows: Sequence[Row]) -> str:
    """Where the seconds went: stages one after the other, and what reading photos takes beside them."""
    known = [row for row in rows if row.reading]
    if not known:
        return ""
    lines = [
        "Where the seconds went: stages one after the other, and what threads took to read photos meanwhile, all together:\n",
        "| row | seeds | opening | planning | initialisation | training | decoding | undistortion | resizing |",
        "|---|---:|" + "---:|" * (len(STAGES) + len(PARTS)),
    ]
    for name in dict.fromkeys(row.row for row in known):
        own = [row for row in known if row.row == name]
        cells = [spread([row.stages.get(stage, 0.0) for row in own], 1) for stage in STAGES]
        cells += [spread([row.reading[part] for row in own], 1) for part in PARTS]
        lines.append(f"| {name} | {len(own)} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def duel(rows: Sequence[Row]) -> str:
    """Auto against the settings chosen by hand: paired by seed, at each mark; and half the seconds."""
    pairs = [
        (one, other)
        for one in rows if one.row == "auto"
        for other in rows if (other.row, other.seed) == (RIVAL, one.seed)
    ]  # fmt: skip
    if len(pairs) < 2:
        return ""
    lines = [f"auto less {RIVAL}, {len(pairs)} seeds in pairs, PSNR with 95 % interval: "]
    for mark in MARKS:
        gain = summarise([at(a, "psnr", mark) - at(b, "psnr", mark) for a, b in pairs])
        lines.append(f"{gain.mean:+.2f} dB [{gain.low:+.2f}, {gain.high:+.2f}] after {mark} s; ")
    reached = [first_at(a, b.final["psnr"]) / b.total for a, b in pairs]
    known = [share for share in reached if math.isfinite(share)]
    lines.append(
        f"its final PSNR was reached in {spread(known, 2)} of its seconds."
        if len(known) == len(pairs)
        else f"its final PSNR was reached in {len(known)} of {len(pairs)} runs within the marks."
    )
    return "".join(lines) + "\n"


def planned(rows: Sequence[Row]) -> str:
    """What auto chose with seed 0, and why."""
    return planned_lines(next((row.plan for row in rows if row.row == "auto" and row.plan), {}))


def planned_lines(plan: dict[str, str]) -> str:
    """A plan as a list.

    Args:
        plan: What was chosen, and why, by component.
    """
    if not plan:
        return ""
    return "What auto chose:\n\n" + "".join(f"- {name}: {text}\n" for name, text in plan.items())


def at(row: Row, metric: str, mark: float) -> float:
    """A metric at the mark of the suite that is nearest to so many seconds.

    Args:
        row: One run.
        metric: Name of the metric.
        mark: Seconds.
    """
    return min(row.timed, key=lambda point: abs(point[0] - mark))[1].get(metric, math.nan)


def before(row: Row) -> float:
    """Seconds of opening, planning, matching and initialising."""
    return sum(row.stages.get(name, 0.0) for name in ("load", "plan", "init"))


def to_95(row: Row) -> float:
    """Seconds to 95 % of the gain from the first to the last mark."""
    from splatproof.suites.marks import seconds_to

    return seconds_to(row.timed)


def first_at(row: Row, psnr: float) -> float:
    """Seconds at which a run first has a PSNR, linear between marks; inf where it never has.

    Args:
        row: One run.
        psnr: What is to be reached, dB.
    """
    points = [(seconds, means["psnr"]) for seconds, means in row.timed]
    if points[0][1] >= psnr:
        return points[0][0]
    for (t0, v0), (t1, v1) in itertools.pairwise(points):
        if v1 >= psnr > v0:
            return t0 + (psnr - v0) / (v1 - v0) * (t1 - t0)
    return math.inf


def spread(values: Sequence[float], digits: int) -> str:
    """A mean with half of its 95 % interval.

    Args:
        values: One a seed.
        digits: Digits after the point.
    """
    found: Summary = summarise(values)
    half = (found.high - found.low) / 2
    told = f" ± {half:.{digits}f}" if math.isfinite(half) else ""
    return f"{found.mean:.{digits}f}{told}"


HEAD = """\
<!-- made by docs/tools/make_minute_page.py; do not edit -->
# The suite minute: time to quality

`bench run minute` trains each row and scores the model as it was after 5, 10, 15, 20, 30, 45 and 60 seconds of
wall time, everything included: opening of the scene, decoding of the photos, planning, matching. Writing the models down
is not counted. A row whose training ends before a mark has its final scores there. `3dgs@released` has the release's
settings squeezed into 3,000 steps, `3dgs@hand` those chosen by hand for brighton_beach (2,000 steps of two views), and
`auto` plans for 60 seconds on the machine it runs on; `auto@...` has one choice fixed. Values are means over seeds with
Student's 95 % interval, which is over seeds alone and says nothing of other views. Machine: {machines}.
"""

if __name__ == "__main__":
    if len(sys.argv) > 1:
        collect(Path(sys.argv[1]), DOCS)
    (DOCS / f"{SUITE}.md").write_text(page(DOCS), encoding="utf-8")
