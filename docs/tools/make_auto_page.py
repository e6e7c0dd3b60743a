"""Make docs/auto.md: python docs/tools/make_auto_page.py RUNS

Reads the records of `bench run auto --out RUNS` and writes docs/auto.json and the page, with
docs/auto_findings.md in it, which is written by hand. Without RUNS the page is made again from the committed
files.
"""

import json
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from kept_rows import committed, joined
from make_minute_page import MACHINE, planned_lines, spread

from splatproof.reference.types.result import Result
from splatproof.reports.statistics import summarise
from splatproof.suites.records import read_record
from splatproof.suites.suite_files import load_suite

DOCS = Path(__file__).parents[1]
SUITE = AUTO = "auto"
NEAR = 0.2
"""Decibels below the best fixed choice that auto may be."""
MORE = 1.2
"""Times the Gaussians of that choice that auto may have."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """What the page keeps of a record."""

    scene: str
    protocol: str
    row: str
    seed: int
    psnr: float
    """Mean over the scored views, dB."""
    primitives: int
    seconds: float
    """Wall seconds of planning and training."""
    machine: str
    plan: dict[str, str]
    """What was chosen, and why."""
    ssim: float | None = None
    """Mean over the scored views; None: not kept, as of older rows."""


def row_of(result: Result) -> Row:
    """What is kept of a record.

    Args:
        result: A finished case of method auto.
    """
    return Row(
        scene=result.scene, protocol=result.protocol, row=result.row, seed=result.seed,
        psnr=result.metrics["psnr"], ssim=result.metrics["ssim_3dgs"], primitives=result.primitives,
        seconds=sum(result.stages.get(name, 0.0) for name in ("plan", "init", "train")),
        machine=", ".join(f"{name} {result.environment.get(name, '')}" for name in MACHINE),
        plan={
            name.removeprefix("plan: "): text
            for name, text in result.environment.items()
            if name.startswith("plan: ")
        },
    )  # fmt: skip


def collect(runs: Path, docs: Path) -> None:
    """Write auto.json from the records of the suite's runs; rows that the runs lack are kept, see `joined`.

    Args:
        runs: Folder that `bench run auto --out` was given.
        docs: Folder of the page.
    """
    cases, kept = load_suite(SUITE).cases, docs / f"{SUITE}.json"
    folders = [runs / SUITE / case.folder for case in cases]
    results = [read_record(folder) for folder in folders if (folder / "record.json").exists()]
    new = [asdict(row_of(one)) for one in results if not one.error]
    rows, _ = joined(new, committed(kept), cases)
    lines = ",\n".join(map(json.dumps, rows))
    kept.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


@dataclass(frozen=True, kw_only=True)
class Regret:
    """Auto beside the best of its fixed choices on a scene."""

    best: str
    """The fixed choice with the highest mean PSNR on auto's seeds."""
    psnr: float
    """Its PSNR less auto's, mean over seeds in pairs, dB: what auto lost."""
    low: float
    high: float
    """Ends of the 95 % interval; nan with one seed."""
    seconds: float
    """Auto's seconds less its."""
    gaussians: float
    """Auto's Gaussians as a multiple of its."""
    seeds: int

    @property
    def verdict(self) -> str:
        """Whether auto is near enough, as far as the seeds can say."""
        if self.gaussians > MORE:
            return "too many Gaussians"
        if self.seeds < 3:
            return "near, too few seeds" if self.psnr <= NEAR else "behind, too few seeds"
        if self.high <= NEAR:
            return "near"
        return "behind" if self.low > NEAR else "undecided"


def regret(rows: Sequence[Row]) -> Regret | None:
    """Auto against the best fixed choice, on the seeds that both have.

    Args:
        rows: Rows of one scene and protocol.

    Returns: None where auto or every fixed choice is missing.
    """
    auto = {row.seed: row for row in rows if row.row == AUTO}
    found = []
    for name in dict.fromkeys(row.row for row in rows if row.row != AUTO):
        pairs = [(auto[row.seed], row) for row in rows if row.row == name and row.seed in auto]
        if not pairs:
            continue
        gain = summarise([other.psnr - own.psnr for own, other in pairs])
        found.append(Regret(
            best=name, psnr=gain.mean, low=gain.low, high=gain.high, seeds=len(pairs),
            seconds=summarise([own.seconds - other.seconds for own, other in pairs]).mean,
            gaussians=summarise([own.primitives / other.primitives for own, other in pairs]).mean,
        ))  # fmt: skip
    return max(found, key=lambda one: one.psnr, default=None)


def page(docs: Path) -> str:
    """The page from the committed files.

    Args:
        docs: Folder with auto.json and auto_findings.md.
    """
    stored = json.loads((docs / f"{SUITE}.json").read_text(encoding="utf-8"))
    rows = [Row(**row) for row in stored]
    asked = Counter((c.scene_name, c.protocol.name, c.row) for c in load_suite(SUITE).cases)
    done = Counter((row.scene, row.protocol, row.row) for row in rows)
    lacking = sum(done[key] < count for key, count in asked.items())
    places = [
        key for key in dict.fromkeys(key[:2] for key in asked) if any(d[:2] == key for d in done)
    ]
    by_place = {key: [row for row in rows if (row.scene, row.protocol) == key] for key in places}
    parts = [
        HEAD.format(machines="; ".join(sorted({row.machine for row in rows})) or "nothing yet"),
        f"**Incomplete**: {lacking} of {len(asked)} rows (a scene each) have fewer seeds than the suite asks "
        "for.\n" if lacking else f"All {len(asked)} rows of the suite are here.\n",
        (docs / f"{SUITE}_findings.md").read_text(encoding="utf-8").rstrip() + "\n",
        "## Regret\n", regrets(by_place),
    ]  # fmt: skip
    for (scene, protocol), own in by_place.items():
        plan = next((row.plan for row in own if row.row == AUTO), {})
        parts += [f"## {scene}, protocol {protocol}\n", table(own), planned_lines(plan)]
    return "\n".join(part for part in parts if part).rstrip() + "\n"


def regrets(by_place: dict[tuple[str, str], list[Row]]) -> str:
    """A line a scene: the best fixed choice, and what auto lost to it."""
    lines = [
        (
            "| scene | protocol | seeds | best fixed choice | its PSNR less auto's | auto's seconds less its | "
            "auto's Gaussians, of its | |"
        ),
        "|---|---|---:|---|---:|---:|---:|---|",
    ]
    for (scene, protocol), rows in by_place.items():
        found = regret(rows)
        if found is None:
            continue
        interval = f" [{found.low:+.2f}, {found.high:+.2f}]" if found.seeds > 1 else ""
        lines.append(
            f"| {scene} | {protocol} | {found.seeds} | {found.best} | {found.psnr:+.2f} dB{interval} | "
            f"{found.seconds:+.0f} | {found.gaussians:.2f} | {found.verdict} |"
        )
    return "\n".join(lines) + "\n"


def table(rows: Sequence[Row]) -> str:
    """A line a row of the suite on one scene, best first."""
    own = {
        name: [row for row in rows if row.row == name]
        for name in dict.fromkeys(row.row for row in rows)
    }
    auto = {row.seed: row.psnr for row in rows if row.row == AUTO}
    lines = [
        "| row | seeds | PSNR | less auto's | SSIM | seconds | Gaussians |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, found in sorted(
        own.items(), key=lambda pair: -summarise([row.psnr for row in pair[1]]).mean
    ):
        paired = [row.psnr - auto[row.seed] for row in found if row.seed in auto]
        alike = [row.ssim for row in found if row.ssim is not None]
        less = f"{summarise(paired).mean:+.2f}" if paired and name != AUTO else ""
        lines.append(
            f"| {name} | {len(found)} | {spread([row.psnr for row in found], 2)} | {less} | "
            f"{spread(alike, 3) if alike else ''} | "
            f"{spread([row.seconds for row in found], 0)} | "
            f"{summarise([float(row.primitives) for row in found]).mean:,.0f} |"
        )
    return "\n".join(lines) + "\n"


HEAD = """\
<!-- made by docs/tools/make_auto_page.py; do not edit -->
# The suite auto: where the plan is right, and where it is not

`bench run auto` trains method auto for 60 seconds on every scene at hand, and again with one of its choices fixed:
`@full-size` photos from the start, `@matched` points and `@sparse-points` without, `@opacity-term` and
`@no-opacity-term`, `@dropout` 0.4 and `@no-dropout`, `@gains` for each photo, `@fewer` and `@more` Gaussians
(pull from which they are split 8e-4 and 2e-4), `@absolute-split` and `@signed-split` large ones split by absolute gradients or as small ones are cloned, `@even-pace` growth to the cap on Gaussians, alone and with the pull of
`@more`, `@unbounded` scales, `@unflattened` Gaussians without the bounds on thickness and at points, `@quicker` and `@release-rates` four
times and once the release's learning rates, `@as-few-photos` what is planned of photos that can be learnt by heart, `@20-seconds` a third of the time, `@still` where things move, `@no-probe`; of few photos `@completed` depths with virtual Gaussians and `@explicit`
ones alone, where PSNR says little: look at SSIM, and at the pictures. *Regret* is what the best of them has more than auto: the best of ten is
partly the luckiest of ten, so auto's regret is overstated, most with one seed. Auto is *near* where the whole 95 % interval
of at least three seeds lies below 0.2 dB, with at most 1.2 times the Gaussians. Machine: {machines}.
"""

if __name__ == "__main__":
    if len(sys.argv) > 1:
        collect(Path(sys.argv[1]), DOCS)
    (DOCS / f"{SUITE}.md").write_text(page(DOCS), encoding="utf-8")
