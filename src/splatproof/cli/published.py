"""`bench published`: what the papers print, beside our own records, and whether they compare."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from splatproof.base.errors import UsageError
from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.suites.published.ours import OurRow
    from splatproof.suites.published.rows import Published

METRICS = {
    "psnr": "PSNR [dB]",
    "ssim": "SSIM",
    "lpips": "LPIPS",
    "seam_psnr": "seam PSNR",
    "bpd_l1": "BPD L1",
    "nbgj": "nBGJ",
    "points_millions": "M points",
    "storage_mb": "MB",
    "fps": "FPS",
}
"""Columns; those are shown that some row has a value for."""
PIPED_WIDTH = 160
"""Characters a line where stdout is no terminal."""


def published(
    suite: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[SUITE]")] = None,
    *,
    scene: str | None = None,
    out: Path = Path("runs"),
) -> None:
    """List the papers whose tables a suite reruns, or show a paper's table rows beside our own.

    Beside every scene stands why our rows are or are not comparable with the printed ones; a
    published value that looks like a slip is marked. With --json each table row is a line: suite,
    scene, ours, method, variant, source, values, comparable, reasons, notes.

    Args:
        suite: Name of the suite that reruns a paper. Without it the papers are listed.
        scene: Name of the one scene of the suite to show. None: all of its scenes.
        out: Folder of our runs, where `bench run SUITE` has left its records.
    """
    from splatproof.base.names import unknown
    from splatproof.suites.published.ours import our_rows
    from splatproof.suites.published.rows import load_published, published_suites, rows_of

    if suite is None and scene is not None:
        raise UsageError(f"--scene {scene}: name its suite too; `bench published` lists them")

    if suite is None:
        for name in published_suites():
            paper = load_published(name)
            count = sum(len(rows_of(paper, one)) for one in paper.scenes)
            record = {"suite": name, "paper": paper.paper, "title": paper.title}
            record |= {"scenes": len(paper.scenes), "rows": count}
            record |= {"contradictions": len(paper.contradictions)}
            text = f"{name}: {paper.title}; {len(paper.scenes)} scenes, {count} rows"
            output.emit(record, text)
        return
    paper = load_published(suite)
    if scene is not None and scene not in paper.scenes:
        raise unknown(f"scene of suite {suite}", scene, paper.scenes)
    ours = our_rows(out / suite)
    for one in [scene] if scene else paper.scenes:
        _show(suite, paper, one, [row for row in ours if row.scene == one])
    if output.wants_json():
        return
    for title, lines in (
        ("cannot be rerun", paper.unavailable),
        ("the paper contradicts itself", paper.contradictions),
    ):
        for line in lines:
            output.print_text(f"{title}: {line}")


def _show(suite: str, paper: "Published", scene: str, ours: "list[OurRow]") -> None:
    """Print the rows of one scene: theirs, then ours."""
    from splatproof.suites.published.rows import reasons, rows_of

    why = reasons(paper, scene)
    rows: list[tuple[str, dict[str, str], str]] = []
    for row in rows_of(paper, scene):
        source = f"{paper.paper}, table {row.table}"
        name = f"{row.method} ({row.variant})" if row.variant else row.method
        rows.append((name, row.values, f"{source} (suspect)" if row.suspect else source))
        if output.wants_json():
            record = {"suite": suite, "scene": scene, "ours": False, "method": row.method}
            record |= {"variant": row.variant, "source": source, "values": row.values}
            record |= {"comparable": not why and not row.suspect, "reasons": why}
            output.print_record(record | {"notes": row.notes})
    for row in ours:
        seeds = f"{row.seeds} seed{'' if row.seeds == 1 else 's'}"
        shown = {name: f"{value:.4g}" for name, value in row.values.items()}
        rows.append((row.method, shown, f"ours, {row.protocol}, {seeds}"))
        if output.wants_json():
            record = {"suite": suite, "scene": scene, "ours": True, "method": row.method}
            record |= {"variant": "", "source": row.protocol, "values": row.values}
            output.print_record(record | {"comparable": not why, "reasons": why, "notes": [seeds]})
    if output.wants_json():
        return
    metrics = [metric for metric in METRICS if any(metric in values for _, values, _ in rows)]
    table = Table(title=scene, title_justify="left", box=None, pad_edge=False)
    for heading in ("method", *(METRICS[metric] for metric in metrics), "source"):
        table.add_column(heading, justify="left" if heading in ("method", "source") else "right")
    for name, values, source in rows:
        table.add_row(name, *(values.get(metric, "–") for metric in metrics), source)
    width = None if sys.stdout.isatty() else PIPED_WIDTH
    Console(width=width, highlight=False, markup=False).print(table)
    verdict = f"ours are not comparable: {'; '.join(why)}" if why else "ours are comparable"
    output.print_text(f"  {verdict}\n")
