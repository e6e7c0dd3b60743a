"""Make docs/cuda.md: python docs/tools/make_cuda_page.py [RUNS/speed.jsonl [FIT ...]], or --released FIT ...

From the rows that `bench study speed --backend cuda --out RUNS` has written on a machine with a GPU, and from folders
of `bench fit` there, each with a file command.txt that holds its command. They are kept in docs/cuda.json with what the
machine and its software are; run there. With --released the folders are those of the table of long trainings, and
all else stays. Without anything the page is written again from that file.
"""

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from splatproof.suites import environment

DOCS = Path(__file__).resolve().parents[1]
ROWS, PAGE = DOCS / "cuda.json", DOCS / "cuda.md"
KEPT = (
    "component", "twin", "case", "size", "forward_ms", "backward_ms", "ratio", "ratio_low", "ratio_high",
    "device_mb", "disturbed_percent", "max_abs_error", "grad_rel_l2", "ok",
)  # fmt: skip
GPU = ("cuda adapter", "gsplat's own call")
CPU = ("cpu avx512", "cpu")
"""What the CPU's rows of the two components are called."""
COMPONENTS = ("rasterizer", "pipeline")
MARK = 1000
"""Step whose seconds the table of trainings has too, for runs that were ended early."""
TEXT = """# The backend `cuda` on a GPU

Made by `python docs/tools/make_cuda_page.py RUNS/speed.jsonl FIT ...` from the rows of
`bench study speed --backend cuda --out RUNS` and from folders of `bench fit` on a machine with a GPU (here in
[cuda.json](cuda.json)); a test compares; the machine's name and versions were written in from what its commands printed.
There `pytest tests/methods/contracts/test_cuda_device.py` holds gsplat's pictures and gradients against the
float64 reference, and trains 3dgs, absgs, mip-splatting, scaffold-gs, pvg and hdgs on both; without a GPU it is
skipped and says so. Its 12 tests passed on the machine below, with warnings of the versions there let pass.

{machine}.
One machine, a quarter of an hour, nothing else started on it; versions are that machine's, not those
pinned here. The CPU's kernels are those of commit 641bf6ae: since then drawing takes 0.8 to 0.9 of its time, which is in none of the
figures below.

## The rasterizer alone

`cuda adapter` is the backend behind our signature, `gsplat's own call` the same rasterizer called directly with
tensors that are on the GPU already, `cpu` ours on all threads of that machine. Milliseconds forward and backward
are medians of interleaved runs, the GPU waited for. `of the CPU's time` is both passes as a share of the CPU's, median over
five rounds, and its least and greatest. Five million Gaussians have no backward pass.

{table}

Largest error of a colour and relative error of the gradients against the float64 reference, on {judged}:

{errors}

The command was changed in two ways, by a script of a few lines that is not kept: of the CPU's implementations it timed the usual
one alone, and it kept rounds in which others used more than 5 % of a core, for which `bench study speed` tells no times but the
ratios. Others used {least:.0f} to {most:.0f} % of one of the {cores} cores, 0 % before the study began; what they were was not
looked at. Cases that the quarter of an hour did not reach are not in the table: the rasterizer's 1,000 Gaussians, its 100,000 on 320x240 and on
smaller pictures, 10,000 and 30,000 on 800x600, and the pipeline's smallest two and 100,000 on 800x600.

- The CPU is ahead at 2,000 Gaussians on 320x240 (1.25 ms for both passes, the adapter 3.1 ms) and level with the adapter at 20,000 (3.1 and
  3.0 ms). The adapter takes 3 ms, however little is drawn.
- The GPU draws ahead with both Gaussians and pixels. At 100,000 Gaussians the CPU's time grows with the picture, the GPU's
  hardly does: it is a third of the CPU's on 800x600, a ninth on 1600x1200, a thirtieth on 3840x2880. A million on 800x600 take a twelfth.
- The adapter adds 0.7 to 1.9 ms to gsplat's own call: it also asks for depth, among other things. On 3840x2880 that doubles
  the time.
- The GPU's gradients are a hundred times further from float64 than the CPU's and well within the budget (1e-3).

## Whole trainings

Method 3dgs on brighton_beach (18 photos, 3 held out), CPU and GPU one after the other on that machine, with the settings of
`bench run brighton` and two photos a step:

{commands}

`s to step {mark:,}` and `s in all` are from the start of the command's work, the opening of the scene and the matching of photos (on the CPU in
either case) included; the scoring is not. PSNR and SSIM are means over the three held-out photos.

{trainings}

- At 500 pixels the CPU is ahead, 29.5 s to 34.5 s; at the photos' own size the GPU is, and trained its 2,000 steps in less time than
  the CPU 1,380: there the time on the machine was over, so this CPU row has no scores.
- The GPU's training is not bound by the rasterizer. At 993 pixels a photo costs 12 ms, and about as many Gaussians and pixels are drawn
  there and back in 3.4 ms (case 100,000 on 800x600 above); at 500 pixels it costs 8 ms, with a quarter of the pixels and a third of the
  Gaussians. What remains is the loss, the optimiser and autograd, operation by operation in torch, for which the CPU has kernels; it was not
  taken apart further.
- The CPU kept 6 to 7 of its 16 cores busy.
- The PSNR differs by 0.03 dB, 0.10 dB at most on a photo, with either sign. One seed: that is no difference that could be told from a seed's.
  The models have 39,818 and 39,914 Gaussians. Of the held-out photos dji_0026 was looked at: paths, lawns and shadows are right in either
  picture, and the crowns of the trees are smears, of other strokes in each.
- Scores of two sizes do not compare: the larger photos have more to get wrong.

## The release's settings, and a minute of a laptop

Method 3dgs with the release's settings and no other, on the GPU, at the photos' own size, beside method auto in a minute on two cores without one:

{released_commands}

{released}

The six runs on the GPU were started together and shared it: their seconds are those of six at once, and the two of 30,000 steps were ended when the
machine's time was over. All were run with what keeps every step's tensors mended (until then a run of 7,000 steps at this size had taken more than the 140 GB of that
GPU by step 6,440), on the machine above. The rows on two cores are of another machine (AMD EPYC, AVX-512, nothing else at work); matching, where there is any, is in their minute.

- On brighton_beach the release's settings learn 15 photos by heart: 34 dB on them and 17 dB on those held out, whatever the seed. A quarter of dji_0018 is a black
  hole with needles at its rim, roads have torn shreds. A minute of auto is 2.5 dB above.
- On caliterra, 65 photos that see each place six times, they are at home: pictures near the photos, and a minute of auto on two cores, with an eighth
  of the Gaussians, ends within half a decibel of either seed, which differ by as much. Its SSIM is lower: less of the fine texture.
- One seed of auto. Which of the two a longer training would favour, this does not say."""


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of rasterizer and pipeline, small cases first.

    Args:
        path: What the study has written, a JSON object a line.
    """
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    kept = [
        {key: row[key] for key in KEPT}
        for row in rows if row["component"] in COMPONENTS and row["twin"] in (*GPU, *CPU)
    ]  # fmt: skip
    return sorted(
        kept,
        key=lambda row: (COMPONENTS.index(row["component"]), row["size"][1], row["size"][0]),
    )


def read_training(folder: Path) -> dict[str, Any]:
    """What is told of one training; one that was ended early has no scores.

    Args:
        folder: What `bench fit` has written, and command.txt.
    """
    lines = (folder / "curve.jsonl").read_text(encoding="utf-8").splitlines()
    curve = [json.loads(line) for line in lines]
    at = {point["step"]: point["seconds"] for point in curve}
    told: dict[str, Any] = {
        "command": (folder / "command.txt").read_text(encoding="utf-8").strip(),
        "steps": curve[-1]["step"], "seconds": curve[-1]["seconds"], "mark_seconds": at.get(MARK),
        "cpu_seconds": curve[-1]["cpu_seconds"], "gaussians": curve[-1]["values"]["gaussians"],
        "psnr": None, "ssim_3dgs": None, "init_seconds": None, "views": {}, "flip": None,
    }  # fmt: skip
    record = folder / "record.json"
    if record.exists():
        held = json.loads(record.read_text(encoding="utf-8"))
        told |= {name: held["metrics"][name] for name in ("psnr", "ssim_3dgs", "flip")}
        told["init_seconds"] = held["stages"]["init"]
        told["views"] = {image["name"]: image["metrics"]["psnr"] for image in held["images"]}
    return told


def machine() -> dict[str, Any]:
    """What the GPU, the processor and the software are here; as it is kept where there is no GPU."""
    if not torch.cuda.is_available():
        return json.loads(ROWS.read_text(encoding="utf-8"))["machine"]
    here = environment.machine("cuda")
    return {
        "GPU": here["gpu"], "gsplat": here["gsplat"],
        "torch": here["torch"].partition("+")[0], "processor": here["cpu"], "cores": here["cores"],
        "SIMD": here["simd"], "memory": here["memory"], "python": here["python"],
    }  # fmt: skip


def lined(heads: tuple[str, ...], lines: Sequence[tuple[str, ...]], texts: int) -> str:
    """A Markdown table.

    Args:
        heads: Title of each column.
        lines: Cells of each line.
        texts: Number of first columns that are text; the others are numbers.
    """
    rule = "|" + "---|" * texts + "---:|" * (len(heads) - texts)
    return "\n".join([_line(heads), rule, *(_line(line) for line in lines)])


def _line(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cells) + " |"


def times(rows: list[dict[str, Any]]) -> str:
    """The table of the rasterizer alone.

    Args:
        rows: The study's.
    """
    heads = ("what", "Gaussians, pixels", "by", "forward ms", "backward ms", "of the CPU's time", "GPU MB")  # fmt: skip
    lines = [
        (
            row["component"], row["case"], row["twin"], f"{row['forward_ms']:.2f}",
            "" if row["backward_ms"] is None else f"{row['backward_ms']:.2f}",
            "" if row["twin"] in CPU
            else f"{row['ratio']:.2g} ({row['ratio_low']:.2g} to {row['ratio_high']:.2g})",
            f"{row['device_mb']:.0f}" if row["device_mb"] else "",
        )
        for row in rows
    ]  # fmt: skip
    return lined(heads, lines, 3)


def errors(rows: list[dict[str, Any]]) -> str:
    """The table of errors, one line a twin: they are of one case.

    Args:
        rows: The study's.
    """
    first = {(row["component"], row["twin"]): row for row in reversed(rows)}
    lines = [
        (*key, f"{first[key]['max_abs_error']:.1e}", f"{first[key]['grad_rel_l2']:.1e}")
        for key in dict.fromkeys((row["component"], row["twin"]) for row in rows)
    ]
    return lined(("what", "by", "colour error", "gradient error"), lines, 2)


def asked(command: str, option: str) -> str:
    """The value of an option in a command; "" without it.

    Args:
        command: The command.
        option: Name of the option, without dashes.
    """
    found = re.search(rf"--{option} (\S+)", command)
    return found[1] if found else ""


def trained(rows: list[dict[str, Any]]) -> str:
    """The table of whole trainings.

    Args:
        rows: As `read_training` makes them.
    """
    heads = (
        "photos", "by", "steps", f"s to step {MARK:,}", "s in all", "of it matching", "CPU s", "PSNR", "SSIM", "Gaussians",
    )  # fmt: skip
    lines = []
    for row in rows:
        width, planned = asked(row["command"], "width"), int(asked(row["command"], "iterations"))
        ended = row["steps"] < planned
        lines.append((
            f"{width} pixels wide" if width else "as they are (993 pixels)", asked(row["command"], "backend"),
            f"{row['steps']:,}" + (f" of {planned:,}, ended" if ended else ""),
            f"{row['mark_seconds']:.1f}", f"{row['seconds']:.1f}",
            "" if ended else f"{row['init_seconds']:.1f}", f"{row['cpu_seconds']:.0f}",
            "" if ended else f"{row['psnr']:.2f}", "" if ended else f"{row['ssim_3dgs']:.3f}",
            f"{row['gaussians']:,.0f}",
        ))  # fmt: skip
    return lined(heads, lines, 2)


def released(rows: list[dict[str, Any]]) -> str:
    """The table of long trainings with the release's settings, and of method auto.

    Args:
        rows: As `read_training` makes them.
    """
    heads = (
        "scene",
        "method",
        "by",
        "seed",
        "steps",
        "s in all",
        "CPU s",
        "PSNR",
        "SSIM",
        "FLIP",
        "Gaussians",
    )
    lines = []
    for row in rows:
        method, scene = row["command"].split()[2:4]
        planned = int(asked(row["command"], "iterations") or row["steps"])
        ended = row["steps"] < planned
        scores = ("psnr", ".2f"), ("ssim_3dgs", ".3f"), ("flip", ".3f")
        lines.append((
            scene, method, asked(row["command"], "backend") or "two cores", asked(row["command"], "seed"),
            f"{row['steps']:,}" + (f" of {planned:,}, ended" if ended else ""), f"{row['seconds']:.0f}",
            f"{row['cpu_seconds']:.0f}", *("" if ended else format(row[name], form) for name, form in scores),
            f"{row['gaussians']:,.0f}",
        ))  # fmt: skip
    return lined(heads, lines, 3)


def page() -> str:
    """The page of the committed rows."""
    known = json.loads(ROWS.read_text(encoding="utf-8"))
    rows, facts = known["rows"], known["machine"]
    others = [row["disturbed_percent"] for row in rows]
    return TEXT.format(
        machine=", ".join(f"{name} {value}" for name, value in facts.items()), cores=facts["cores"],
        table=times(rows), errors=errors(rows), judged="1,000 Gaussians and 64x48 pixels",
        least=min(others), most=max(others), mark=MARK,
        commands="```\n" + "\n".join(row["command"] for row in known["trainings"]) + "\n```",
        trainings=trained(known["trainings"]),
        released_commands="```\n" + "\n".join(row["command"] for row in known["released"]) + "\n```",
        released=released(known["released"]),
    )  # fmt: skip


if __name__ == "__main__":
    if sys.argv[1:2] == ["--released"]:
        found = json.loads(ROWS.read_text(encoding="utf-8"))
        found["released"] = [read_training(Path(name)) for name in sys.argv[2:]]
        ROWS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    elif len(sys.argv) > 1:
        found = {
            "machine": machine(),
            "rows": read_rows(Path(sys.argv[1])),
            "trainings": [read_training(Path(name)) for name in sys.argv[2:]],
            "released": json.loads(ROWS.read_text(encoding="utf-8"))["released"],
        }
        ROWS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(), encoding="utf-8")
