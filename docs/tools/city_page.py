"""docs/city.md from the rows of the suite `city`: what was expected, as the claims page judges it, and tables."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from kept_rows import Picture

from splatproof.metrics import scene_registry as registry
from splatproof.reference.types.result import Result
from splatproof.reports.findings.finding import Finding
from splatproof.reports.measured import measured
from splatproof.reports.statistics import summarise
from splatproof.reports.verdicts import VISITS

PLY_NUMBERS = 62
"""float32 numbers of a Gaussian of degree 3 in the .ply of the 3DGS release."""
JUDGED = ("psnr", "ssim_3dgs", "flip", "seam_psnr_partition", "bpd_l1_partition", "nbgj_partition")
"""Metrics of single images that claims are about."""
Cell = tuple[str, str, int, float]
"""Key of a row, heading, digits after the point, factor."""
QUALITY: tuple[Cell, ...] = (
    ("psnr", "PSNR ↑", 2, 1.0), ("ssim_3dgs", "SSIM ↑", 4, 1.0), ("flip", "FLIP ↓", 4, 1.0),
    ("seam_psnr_partition", "Seam PSNR ↑", 2, 1.0), ("bpd_l1_partition", "BPD L1 ↓", 4, 1.0), ("nbgj_partition", "nBGJ ↓", 2, 1.0),
    ("seam_coverage_partition", "seam %", 1, 100.0), ("primitives", "Gaussians", 0, 1.0),
    ("fps", "FPS ↑", 1, 1.0), ("disk_mb", "disk MB ↓", 2, 1.0),
    ("bytes_each", "bytes a Gaussian ↓", 1, 1.0),
)  # fmt: skip
BALANCE: tuple[Cell, ...] = (
    ("least_visits", "visits ≥", 0, 1.0), ("block_densifications", "densified ≥", 0, 1.0),
    ("retention", "kept %", 1, 100.0), ("over_hard_cut", "over a hard cut", 3, 1.0),
    ("edge_cut", "edge cut", 0, 1.0),
    ("load_max_over_mean", "load", 2, 1.0), ("views_max_over_mean", "views", 2, 1.0),
    ("cpu_max_over_mean", "CPU time", 2, 1.0),
    ("seconds_max_over_mean", "time", 2, 1.0), ("seconds_std_over_mean", "time std/mean", 3, 1.0),
    ("memory_max_over_mean", "memory", 2, 1.0), ("peak_memory_mb", "peak MB", 0, 1.0),
)  # fmt: skip
STAGES: tuple[Cell, ...] = (
    *((f"stage_{name}", name, 1, 1.0)
      for name in ("coarse", "partition", "blocks", "stitch", "refine", "compress")),
    ("training_seconds", "all", 1, 1.0), ("four_machine_seconds", "on four machines", 1, 1.0),
    ("four_machine_cpu_seconds", "processor seconds there", 1, 1.0),
)  # fmt: skip
PEAKS: tuple[Cell, ...] = tuple((f"{stage}_peak_mb", stage, 0, 1.0) for stage in registry.STAGES)
SEAMS: tuple[Cell, ...] = (
    ("seam_psnr_partition", "seam_psnr_partition ↑", 2, 1.0), ("seam_psnr_released", "seam_psnr_released ↑", 2, 1.0),
    ("bpd_l1_partition", "bpd_l1_partition ↓", 4, 1.0), ("seam_l1_released", "seam_l1_released ↓", 4, 1.0),
    ("nbgj_partition", "nbgj_partition ↓", 2, 1.0), ("seam_gradient_ratio_released", "seam_gradient_ratio_released ↓", 2, 1.0),
    ("seam_depth_gradient_ratio_released", "seam_depth_gradient_ratio_released ↓", 2, 1.0),
)  # fmt: skip
"""Each of the partition's metrics beside what the release's code takes in its place."""
GEOMETRY: tuple[Cell, ...] = (
    ("geometry_accuracy", "accuracy m ↓", 3, 1.0), ("geometry_completeness", "complete % ↑", 1, 100.0),
    ("geometry_f_score", "F-score ↑", 3, 1.0),
    ("geometry_blind_completeness", "blind complete % ↑", 1, 100.0),
)  # fmt: skip
Row = Mapping[str, Any]


def row_of(result: Result) -> dict[str, Any]:
    """What the page and verdicts need of a result, as plain JSON; what is undefined is left out."""
    row = asdict(measured(result))
    # JSON has no such number; blocks that were trained for another row leave no curve
    if math.isinf(row["late_gain"]):
        del row["late_gain"]
    row["images"] = {
        name: {metric: value for metric, value in scores.items() if metric in JUDGED}
        for name, scores in row["images"].items()
    }
    more = {
        "ply_bytes": 4.0 * PLY_NUMBERS * result.primitives,
        "bytes_each": result.bytes_on_disk / max(result.primitives, 1),
        "fps": 1000 / result.render_ms if result.render_ms > 0 else math.nan,
        "training_seconds": result.training_seconds,
        **{f"stage_{name}": seconds for name, seconds in result.stages.items()},
        **{name: float(n) for name, n in result.counters.items() if name == VISITS},
    }
    row["values"] |= {k: float(f"{v:.6g}") for k, v in sorted(more.items()) if math.isfinite(v)}
    return row | {"blocks": int(str(result.settings.get("blocks", 1)))}


def render_city(
    rows: Sequence[Row],
    pictures: Sequence[Picture],
    expected: Sequence[Finding] = (),
    findings: str = "",
    planned: Sequence[tuple[str, str]] = (),
) -> str:
    """The whole page.

    Args:
        rows: As `row_of` makes them, in the suite's order.
        pictures: What is shown below the tables.
        expected: Claims with their verdicts: those of the claims page, so that the two agree.
        findings: Why what was expected came out as it did, in words; Markdown.
        planned: Scenes and rows that the suite asks for, in its order; those without a record are named.
    """
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    machines = sorted({row["machine"] for row in rows if row["machine"]})
    seeds = sorted({row["seed"] for row in rows})
    parts = [
        HEAD.format(machines="; ".join(machines), seeds=", ".join(map(str, seeds))),
        "## What was expected\n",
        _verdicts(expected),
        *([findings.rstrip() + "\n"] if findings else []),
        *_not_run(rows, planned),
        *(_scene(scene, [row for row in rows if row["scene"] == scene]) for scene in scenes),
        "## Pictures\n",
        *map(_shown, pictures),
    ]
    return "\n".join(parts).rstrip() + "\n"


def _shown(picture: Picture) -> str:
    return f"![{picture.caption}]({picture.path})\n\n{picture.caption}\n"


def _not_run(rows: Sequence[Row], planned: Sequence[tuple[str, str]]) -> list[str]:
    """What the suite asks for and nobody has run, by scene."""
    done = {(row["scene"], row["row"]) for row in rows}
    lacking: dict[str, list[str]] = {}
    for scene, row in dict.fromkeys(planned):
        if (scene, row) not in done:
            lacking.setdefault(scene, []).append(f"`{row}`")
    if not lacking:
        return []
    lines = [f"- {scene}: {', '.join(names)}." for scene, names in lacking.items()]
    return ["### Not run at this length\n", "\n".join(lines) + "\n"]


def _verdicts(expected: Sequence[Finding]) -> str:
    """A line a claim, in the words of the claims page."""
    lines = ["| verdict | claim | rows | asked | here, 95 % interval | seeds | why |",
             "|---|---|---|---:|---:|---:|---|"]  # fmt: skip
    for one in expected:
        rows = " − ".join(f"`{row}`" for row in one.rows) + f", {one.metric}"
        cells = (one.verdict, one.text, rows, one.asked, one.here, str(one.seeds or ""), one.reason)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _scene(scene: str, rows: Sequence[Row]) -> str:
    """The tables of a scene."""
    sections = (
        ("", QUALITY),
        ("Seams, by the partition and as StitchGS's release takes them:", SEAMS),
        ("Blocks, the largest over the mean:", BALANCE),
        ("Wall seconds:", STAGES),
        ("Peak memory of the largest process of each stage, MB:", PEAKS),
        ("Rendered depth against the truth:", GEOMETRY),
    )
    texts = [f"## {scene} ({rows[0]['protocol']})\n"]
    for title, cells in sections:
        shown = [cell for cell in cells if any(cell[0] in row["values"] for row in rows)]
        if shown:
            texts.append((title + "\n\n" if title else "") + _table(rows, shown))
    failed = [f"- {row['row']} seed {row['seed']}: {row['error']}" for row in rows if row["error"]]
    if failed:
        texts.append("Failed:\n\n" + "\n".join(failed) + "\n")
    return "\n".join(texts)


def _table(rows: Sequence[Row], cells: Sequence[Cell]) -> str:
    names = list(dict.fromkeys((row["row"], row["blocks"]) for row in rows))
    lines = [
        "| row | K | " + " | ".join(cell[1] for cell in cells) + " |",
        "|---|---" + "|---:" * len(cells) + "|",
    ]
    for name, count in names:
        own = [_with_growth(row) for row in rows if row["row"] == name]
        texts = [_text([values.get(key) for values in own], digits, by)
                 for key, _, digits, by in cells]  # fmt: skip
        if any(text != "–" for text in texts):
            lines.append(f"| {name} | {count} | " + " | ".join(texts) + " |")
    return "\n".join(lines) + "\n"


def _with_growth(row: Row) -> Mapping[str, float]:
    """A row's values; one model is its own only block, and was densified as often as its trainer counted."""
    grown = {"block_densifications": float(row["grown"])}
    return {**(grown if row["blocks"] == 1 and row["grown"] >= 0 else {}), **row["values"]}


def _text(values: Sequence[float | None], digits: int, factor: float) -> str:
    """Mean over seeds and half its 95 % interval; a dash where it is undefined."""
    known = [value * factor for value in values if value is not None]
    if not known or len(known) < len(values):
        return "–"
    found = summarise(known)
    half = (found.high - found.low) / 2
    text = f"{found.mean:,.{digits}f}"
    return text if math.isnan(half) else f"{text} ± {half:,.{digits}f}"


HEAD = """# The city suite

Made by `python docs/tools/make_city_page.py RUNS` from the records of `bench run city --out RUNS` (here in
[city.json](city.json)); a test compares. Measured on {machines}; seeds {seeds}. Numbers are means over seeds and half
their 95 % intervals; differences of rows are judged, image by image, on the [claims page](claims.md), from which the verdicts
below are. A dash among costs: the row was recorded before what the processes of blocks cost was counted. Seams are scored on the
partition's mask (`*_partition`), which is the same for every merge; the paper's own is empty after a hard cut.

- `3dgs` is one block, with as many steps as all blocks of the other rows together.
- `stitchgs@hard`, `@merge`, `@gcr` and `stitchgs` are one training, merged by a hard cut, by SIS, refined (GCR),
  and compressed; `odbp+stitch@hard` and `odbp+stitch` likewise. `@k8` has eight blocks.
- `odbp+stitch@parts` is `@small` refined apart: each block's photos refine what they show of the merged model, and of what several
  blocks' photos show the mean is kept, so that no machine refines the whole; the coarse model, which is of the whole scene, one
  machine still trains.
- `stitchgs@hard-gcr` is refined without stitching, `@one-gcr` without blocks. `@shares` and `@fade` merge from both
  sides of a wall and are refined; `@walls` is `@shares` whose refinement moves what lies near walls too, and
  `odbp+stitch@small` the same of `odbp+stitch`, stored in our own small file in place of the paper's.
- `@coarse` rows start their blocks from a coarse model, as `citygaussian` and all of `stitchgs` and `odbp+stitch` do.
- `3dgs@tuned` and `odbp+stitch@tuned` have method auto's settings for a short flight (a bound on scales, the opacity term, rates four times as
  large that settle) and as many visible updates: one model visits each of its photos as often as a block visits each of its own.
  The coarse model's steps, which blocks have besides, are not counted. `-double` rows have twice the steps, `@tuned-k8-double` eight blocks.
- `blockgaussian@sideways` is `@coarse` that also compares views from beside a photo, `@terms` (`~depth-sweep`: depth of matched
  photos) that also has inverse depth and volume; `vastgaussian@appearance` is `@coarse` with a network of each photo's
  appearance, `@gain` with three gains a photo.
- `stitchgs@light-...` and `@place-...` have a planted seam: each block's photos are up to a fifth brighter or darker in a colour,
  or its cameras stand half a hundredth of the scene's extent aside, each block's another way; coarse model and refinement
  see all as it is. `-walls` is `-fade` whose refinement moves what lies near walls; `-level` is `-walls` whose blocks' colours
  are first brought to the photos' level, by three factors a block in closed form.
- *on four machines* is what the whole would take if four machines had trained the blocks (and refined the parts), simulated from
  their measured seconds; *processor seconds there* from those of the processor, which other work on the machine changes less.
- `stitchgs@overlap` is `@gcr` whose cores overlap by the margin that blocks are trained with, and are all kept: the paper's storage
  grows as if its cores did. Where two overlap, optical depth is there twice. `@overlap-fade` fades what lies there, so that it is
  there once. *over a hard cut* says how many Gaussians a merge keeps for each that a hard cut of the same blocks keeps.
- *visits* are those of the photo that a block visited least; below 40 the claims page calls a row too short. Rows that were recorded
  before visits, merges' growth and stages' memory were counted have a dash there, or no such column where no row of a scene has it.
- `@half` and `@double` have half and twice the steps: what further steps would still change, by which the claims page tells
  rows that are too short to judge.
- Seams are scored on the pixels whose surface lies within a normalised distance of 1.1 of two regions or more of the
  row's partition (`metrics/seam_partition.py`), whatever the merge kept: rows of one partition are compared on the
  same pixels, rows of different partitions are not. `3dgs` has no partition and no seam. Metrics with `_released` in their names
  are what StitchGS's release computes (`metrics/seam_released.py`), over the rims of its boxes: other pixels, other quantities,
  and none where blocks are no boxes.
- The runs are minutes long, hundreds of times shorter than the papers'; the numbers compare rows, not papers.
"""
