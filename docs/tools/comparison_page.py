"""The page of a suite that compares methods: claims with verdicts, tables, printed numbers, strips."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from kept_rows import Picture
from printed_tables import Printed, printed_tables

from splatproof.reports.claims.claim import Claim
from splatproof.reports.claims.obstacles import method_of
from splatproof.reports.measured import Measured
from splatproof.reports.statistics import MISSED, summarise
from splatproof.reports.verdicts import SETTLED, Judged, Verdict, judge, other_length
from splatproof.suites.suite_files import suite_names

Cell = tuple[str, str, int]
"""Key of a value, heading, digits after the point."""
QUALITY: tuple[Cell, ...] = (
    ("psnr", "PSNR ↑", 2), ("seen_psnr", "of what is seen ↑", 2), ("moving_psnr", "moving ↑", 2), ("still_psnr", "still ↑", 2),
    ("ssim_3dgs", "SSIM ↑", 4), ("flip", "FLIP ↓", 4), ("depth_abs_rel", "depth AbsRel ↓", 3),
    ("depth_delta1", "depth δ1 ↑", 3), ("disk_mb", "stored MB ↓", 2), ("render_ms", "ms a frame ↓", 1),
    ("primitives", "stored primitives", 0),
)  # fmt: skip
ANCHORED = ("scaffold-gs", "dlg-gs", "hdgs")
"""Methods whose stored primitives are anchors, of which each becomes several Gaussians when it is drawn."""
COSTS: tuple[Cell, ...] = (
    ("train_seconds", "train s", 0), ("cpu_seconds", "CPU s", 0), ("peak_memory_mb", "peak MB", 0),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Page:
    """What a page is made of, apart from pictures."""

    suite: str
    title: str
    intro: str
    """What the rows are, in Markdown."""
    planned: Mapping[tuple[str, str, str], int]
    """Seeds that the suite asks for, by scene, protocol and row, in its order."""
    rows: Sequence[Measured]
    claims: Sequence[Claim]
    printed: Sequence[Printed]
    findings: str
    """What came out and why, in words; Markdown, written by hand."""


def render_page(page: Page, pictures: Sequence[Picture]) -> str:
    """The whole page.

    Args:
        page: Rows, claims and words.
        pictures: What is shown below the tables.
    """
    # each claim has its own draws, as on the claims page, so that both print the same interval
    found = [judge(claim, page.rows, np.random.default_rng(0)) for claim in page.claims]
    places = list(dict.fromkeys((scene, protocol) for scene, protocol, _ in page.planned))
    parts = [
        _head(page),
        "## Claims\n",
        _claims(found),
        *([page.findings.rstrip() + "\n"] if page.findings.strip() else []),
        *(_side_by_side(page, scene) for scene in dict.fromkeys(scene for scene, _ in places)),
        *(_place(page, scene, protocol) for scene, protocol in places),
        *printed_tables(page.printed, page.rows),
        "## Pictures\n" if pictures else "",
        *(f"![{shown.caption}]({shown.path})\n\n{shown.caption}\n" for shown in pictures),
    ]
    return "\n".join(part for part in parts if part).rstrip() + "\n"


def _head(page: Page) -> str:
    done = [row for row in page.rows if not row.error]
    machines = "; ".join(sorted({row.machine for row in done if row.machine})) or "nothing yet"
    return HEAD.format(
        title=page.title, suite=page.suite, machines=machines, intro=page.intro.rstrip(),
        missing=_missing(page) + _unknown(page), settled=SETTLED, missed=round(100 * MISSED), larger=_larger(page.suite), counted=_counted(page),
        turns=_turns(done),
    )  # fmt: skip


def _turns(done: Sequence[Measured]) -> str:
    """Which rows' frames were timed in turns; empty where none were."""
    sessions: dict[tuple[str, str], list[str]] = {}
    for run in done:
        if run.turns:
            sessions.setdefault((run.turns, f"{run.scene}, {run.protocol}"), []).append(run.row)
    if not sessions:
        return ""
    groups = [
        f"{', '.join(f'`{row}`' for row in dict.fromkeys(rows))} ({place})"
        for (_, place), rows in sessions.items()
    ]
    return f", but those of a frame of {'; '.join(groups)}, which had turns with one another (`bench frames`)"


def _counted(page: Page) -> str:
    """What the tables count, where some rows count anchors."""
    return COUNTED if any(_anchored(row) for _, _, row in page.planned) else ""


def _anchored(row: str) -> bool:
    """Whether a row's method stores anchors."""
    return method_of(row) in ANCHORED


def _larger(suite: str) -> str:
    """Half a sentence on the suite's form on a larger scene, where there is one."""
    name = f"{suite}-medium"
    return f"; `bench run {name}` is the larger scene" if name in suite_names() else ""


def _missing(page: Page) -> str:
    """One paragraph on the rows that the suite asks for and that have fewer seeds than it says."""
    seeds = Counter((r.scene, r.protocol, r.row) for r in page.rows if not r.error)
    asked = Counter(row for _, _, row in page.planned)
    lacking = [key for key, count in page.planned.items() if seeds[key] < count]
    if not lacking:
        return f"All {len(page.planned)} rows of the suite are here."
    short = Counter(row for _, _, row in lacking)
    named = ", ".join(f"{row} ({short[row]} of {asked[row]})" for row in short)
    return f"**Incomplete**: {len(lacking)} of {len(page.planned)} rows (a scene and protocol each) lack seeds: {named}."


def _unknown(page: Page) -> str:
    """A sentence on records of before settings were kept in them."""
    without = Counter(row.row for row in page.rows if not row.settings)
    if not without:
        return ""
    named = ", ".join(f"{row} ({count})" for row, count in without.items())
    return (
        f"\n\n{sum(without.values())} of {len(page.rows)} records are of before records kept their settings, so that the "
        f"suite's are not checked against theirs: {named}."
    )


def _claims(found: Sequence[Judged]) -> str:
    counts = Counter(one.verdict for one in found)
    total = ", ".join(f"{counts[v]} *{v}*" for v in get_args(Verdict) if counts[v])
    lines = [
        f"{len(found)} claims: {total}.\n",
        "| verdict | claim | rows | printed | here, 95 % interval | seeds | why |",
        "|---|---|---|---:|---:|---:|---|",
        *map(_claim, found),
    ]
    return "\n".join(lines) + "\n"


def _claim(one: Judged) -> str:
    claim = one.claim
    asked = f"bar {claim.shown(claim.bar)}" if claim.bar is not None else (
        "" if claim.printed is None else claim.shown(claim.printed))  # fmt: skip
    here = ""
    if one.difference is not None:
        mean, low, high = (
            claim.shown(claim.as_effect(v))
            for v in (one.difference.mean, one.difference.low, one.difference.high)
        )
        here = f"{mean} [{low}, {high}]"
    rows = " − ".join(f"`{row}`" for row in claim.rows) + f", {claim.metric}"
    if claim.protocol:
        rows += f", {claim.protocol}"
    if len(claim.scenes) > 1:
        rows += f", mean of {', '.join(claim.scenes)}"
    text = f"{claim.paper}: {claim.text}" + (f" ({claim.source})" if claim.source else "")
    cells = (f"**{one.verdict}**", text, rows, asked, here, str(one.seeds or ""), one.reason)
    return "| " + " | ".join(cells) + " |"


def _side_by_side(page: Page, scene: str) -> str:
    """PSNR of each row under each protocol of a scene; nothing where there is one protocol."""
    done = [row for row in page.rows if row.scene == scene and not row.error]
    protocols = list(dict.fromkeys(p for s, p, _ in page.planned if s == scene))
    named = _compared(page, dict.fromkeys(row for s, _, row in page.planned if s == scene))
    if len(protocols) < 2:
        return ""
    lines = [f"## {scene}, PSNR by protocol\n", "| row | " + " | ".join(protocols) + " |",
             "|---" + "|---:" * len(protocols) + "|"]  # fmt: skip
    for name in named:
        own = [[r.values.get("psnr") for r in done if (r.row, r.protocol) == (name, p)]
               for p in protocols]  # fmt: skip
        if any(own):
            lines.append(f"| {name} | " + " | ".join(number(values, 2) for values in own) + " |")
    return "\n".join(lines) + "\n"


def _place(page: Page, scene: str, protocol: str) -> str:
    """The tables of one scene under one protocol."""
    rows = [r for r in page.rows if (r.scene, r.protocol) == (scene, protocol)]
    named = [row for s, p, row in page.planned if (s, p) == (scene, protocol)]
    texts = [f"## {scene}, protocol {protocol}\n"]
    if table := _table(rows, _compared(page, named), QUALITY):
        texts.append(table)
    if lengths := _lengths(rows, named):
        texts.append("What a run took, and whether it was long enough:\n\n" + lengths)
    failed = [f"- {row.row} seed {row.seed}: {row.error}" for row in rows if row.error]
    if failed:
        texts.append("Failed:\n\n" + "\n".join(failed) + "\n")
    return "\n".join(texts)


def _compared(page: Page, named: Iterable[str]) -> list[str]:
    """The rows among some that tables compare: one of other length is a control, but for claims that look at it."""
    return [name for name in named if compared_row(name, page.claims)]


def compared_row(row: str, claims: Iterable[Claim]) -> bool:
    """Whether a page shows a row beside others: one of another length is a control, but for claims that look at it.

    Args:
        row: Its name.
        claims: Those of the page.
    """
    return not is_length(row) or any(row in claim.rows for claim in claims)


def is_length(row: str) -> bool:
    """Whether a row is its method, or a variant of it, with half or twice the steps."""
    return bool(other_length(row.partition("~")[0].partition("@")[2])[1])


def _table(rows: Sequence[Measured], named: Sequence[str], cells: Sequence[Cell]) -> str:
    done = [row for row in rows if not row.error and row.row in named]
    shown = [cell for cell in cells if any(cell[0] in row.values for row in done)]
    if not shown:
        return ""
    lines = ["| row | seeds | " + " | ".join(cell[1] for cell in shown) + " |",
             "|---|---:" + "|---:" * len(shown) + "|"]  # fmt: skip
    for name in named:
        own = [row.values for row in done if row.row == name]
        if own:
            texts = [number([v.get(key) for v in own], digits) for key, _, digits in shown]
            if shown[-1][0] == "primitives" and _anchored(name):
                texts[-1] += " †"
            lines.append(f"| {name} | {len(own)} | " + " | ".join(texts) + " |")
    return "\n".join(lines) + "\n"


def number(values: Sequence[float | None], digits: int) -> str:
    """Mean over seeds and half its 95 % interval; a dash where a seed lacks the value.

    Args:
        values: One a seed.
        digits: Digits after the point.
    """
    known = [value for value in values if value is not None]
    if not known or len(known) < len(values):
        return "–"
    found = summarise(known)
    half = (found.high - found.low) / 2
    text = f"{found.mean:,.{digits}f}"
    return text if math.isnan(half) else f"{text} ± {half:,.{digits}f}"


def _lengths(rows: Sequence[Measured], named: Sequence[str]) -> str:
    """What shows whether runs were long enough: steps, growth, gain at the end, cost."""
    done = [row for row in rows if not row.error]
    if not done:
        return ""
    lines = ["| row | steps | grew | last fifth gained dB | " + " | ".join(c[1] for c in COSTS) + " | PSNR |",
             "|---|---:|---:|---:" + "|---:" * (len(COSTS) + 1) + "|"]  # fmt: skip
    for name in named:
        own = [row for row in done if row.row == name]
        if not own:
            continue
        costs = [number([row.values.get(key) for row in own], digits) for key, _, digits in COSTS]
        gain = float(np.mean([row.late_gain for row in own]))
        psnr = number([row.values.get("psnr") for row in own], 2)
        texts = (str(own[0].steps), str(min(row.grown for row in own)), f"{gain:.2f}", *costs, psnr)
        lines.append(f"| {name} | " + " | ".join(texts) + " |")
    return "\n".join(lines) + "\n"


HEAD = """# {title}

Made by `python docs/tools/make_{suite}_page.py RUNS` from the records of `bench run {suite} --out RUNS` (here in
[{suite}.json]({suite}.json)); a test compares. `bench run {suite} --quick` runs every method in miniature and
judges nothing{larger}. Measured on {machines}; times beside other work{turns}.

{intro}

{missing}

Numbers are means over seeds, with ± half of their 95 % interval.

How a claim is judged (`reports/verdicts.py`): paired bootstrap over images and seeds, 95 %; over seeds alone of what has no value
for each image (sizes, costs, errors of depth and surface). Scenes are those that are named, no sample of others. Simulated with three
seeds, such intervals miss the truth in 5 of 100 experiments, and in up to {missed} where images are three to six and one of them decides.
*holds*: the interval excludes 0 on the claimed side and reaches half the printed effect; *direction only*: excludes 0, ends below that;
*no difference*: contains 0 (with the effect that would have shown in four of five such experiments); *contradicted*:
excludes 0 on the other side. A claim with a bar *holds* where the whole interval reaches it and is *undecided* where
the interval lies on both sides. *too short to judge*: fewer than three seeds, nothing was ever densified, or a row
still changed by more than {settled} dB (by more than a tenth, of sizes and times) and by more than what decides: its
difference from the other, or what parts that from the bar. Rows `@half` and `@double`, which have half and twice the steps, say so, or,
without one, the training loss of the last fifth. Tables show such a row beside the others only where a claim compares it.
{counted}"""
COUNTED = """
*stored primitives* are Gaussians, or, with †: anchors, each of which becomes up to k Gaussians when it is drawn
(scaffold-gs and dlg-gs: k = 10; hdgs: K = 12 where its row says nothing else). Numbers with and without † do not compare.
"""
