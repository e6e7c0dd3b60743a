"""The dashboard as a folder of plain files that a browser opens from disk."""

import itertools
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from splatproof.base.errors import UsageError
from splatproof.base.files import write_bytes
from splatproof.reference.types.result import picture_name
from splatproof.reports.dashboard import assets
from splatproof.reports.dashboard.index import Progress, silent
from splatproof.reports.dashboard.numbers import script
from splatproof.reports.dashboard.sides import Side, comparable_pairs
from splatproof.reports.dashboard.site import THUMB_QUALITY, THUMB_WIDTH, Site
from splatproof.reports.dashboard.summary import Summary
from splatproof.reports.pictures import spread, to_jpeg

WIDEST, QUALITY = 1280, 90
"""Pixels across and JPEG quality of pictures; the store keeps the originals."""
PAIRS = 2000
"""Comparisons that are computed at most: rows with each other, and neighbours of histories first."""
MARK = "splatproof-dashboard"
"""File that says that a folder is a dashboard's, so that it may be replaced."""


@dataclass(frozen=True, kw_only=True)
class Built:
    """What a static build holds."""

    files: int
    bytes: int
    left_out: str
    """What it does not have and the store has, in one line; empty: nothing."""


def build_site(site: Site, folder: Path, picture_mb: float, progress: Progress = silent) -> Built:
    """Write the whole dashboard below a folder; one that an earlier build made is replaced.

    Pictures are carried of each row's first seed, as JPEG, image by image from worst and best by name to
    those between, until the budget is spent; the page says how many were left out.

    Args:
        site: What is written.
        folder: New or empty folder, or one of an earlier build.
        picture_mb: Megabytes (2^20 bytes) of pictures; 0: none.
        progress: Told of what is being written.
    Raises: UsageError where the folder holds something else.
    """
    if folder.exists() and any(folder.iterdir()) and not (folder / MARK).exists():
        raise UsageError(f"--static {folder}: holds something else; name a new or empty folder")
    if folder.exists():
        shutil.rmtree(folder)
    write_bytes(
        folder / MARK, b"made by bench dashboard --static; a new build replaces this folder\n"
    )
    have, wanted = _pictures(site, folder, picture_mb * 2**20, progress)
    names, computed, pairs = _names(site)
    said = []
    kept = sum(map(len, have.values()))
    if kept < wanted:
        said.append(f"{wanted - kept} of {wanted} images of first seeds have no pictures here")
    others = sum(len(one.numbers.images) for one in site.state.index.shown) - wanted
    if others:
        said.append(f"pictures of other seeds ({others} images) are left out")
    if computed < pairs:
        said.append(f"{pairs - computed} of {pairs} comparisons are left out")
    left_out = "; ".join(said)
    index = site.index_data("static", "jpg", have, left_out)
    write_bytes(folder / "data" / "index.js", script("index", index).encode())
    for done, name in enumerate(names):
        progress("files", done, len(names))
        found = site.read(name)
        if found is not None:
            write_bytes(folder / name, found[0])
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    return Built(files=len(sizes), bytes=sum(sizes), left_out=left_out)


def _names(site: Site) -> tuple[list[str], int, int]:
    """Paths of everything but index and pictures; comparisons among them, and how many there could be."""
    state = site.state
    names = ["index.html", "app/plotly.min.js", *(f"app/{name}" for name in assets.app_names())]
    names += ["data/images.js", "data/claims.js"]
    names += [f"data/table/{table}.js" for table in state.tables]
    names += [f"data/history/{series}.js" for series in state.series]
    for run in state.runs:
        names += [f"data/run/{run}.js", f"record/{run}.json"]
    pairs = [*_neighbours(state.sides), *comparable_pairs(state.sides.values())]
    names += [f"data/compare/{one.id}~{other.id}.js" for one, other in pairs[:PAIRS]]
    return names, min(len(pairs), PAIRS), len(pairs)


def _neighbours(sides: dict[str, Side]) -> Iterator[tuple[Side, Side]]:
    """Each version and the one after it, both ways round."""
    series: dict[tuple[str, str, str], list[Side]] = {}
    for side in sides.values():
        if side.kind == "version":
            series.setdefault((side.suite, side.label, side.protocol), []).append(side)
    for own in series.values():
        ordered = sorted(own, key=lambda side: max(run.ended for run in side.runs))
        for before, after in itertools.pairwise(ordered):
            yield before, after
            yield after, before


def _pictures(
    site: Site, folder: Path, budget: float, progress: Progress
) -> tuple[dict[str, list[int]], int]:
    """Write pictures until the budget is spent.

    Returns: Places of the images that are there by run, and how many images there could be.
    """
    chosen = list(_first_seeds(site))
    wanted = sum(len(run.numbers.images) for run in chosen)
    have: dict[str, list[int]] = {run.run: [] for run in chosen}
    longest = max((len(run.numbers.images) for run in chosen), default=0)
    truths: dict[str, str] = {}
    for one in site.state.index.runs:  # the page looks for a truth in this order too
        if one.run in have:
            truths.setdefault(one.numbers.data, one.run)
    spent = 0
    for turn, run in itertools.product(range(longest), chosen):
        if spent >= budget:
            break
        order = spread(len(run.numbers.images))
        if turn >= len(order):
            continue
        kinds = ["render", "error", *(["truth"] if truths[run.numbers.data] == run.run else [])]
        spent += _write_image(site, folder, run, order[turn], kinds)
        have[run.run].append(order[turn])
        progress("pictures", spent, int(budget))
    return {run: sorted(places) for run, places in have.items() if places}, wanted


def _first_seeds(site: Site) -> Iterator[Summary]:
    for table in site.state.tables.values():
        brief = table["brief"]
        for row in brief["rows"] if brief["scene"] else ():
            if row["runs"]:
                yield site.state.runs[row["runs"][0]]


def _write_image(site: Site, folder: Path, run: Summary, place: int, kinds: list[str]) -> int:
    """Write the pictures of one image, and a small one of its render; bytes that they take."""
    file, spent = picture_name(list(run.numbers.images)[place]), 0
    for kind in kinds:
        png = site.picture(run.run, kind, file)
        if png is None:
            continue
        name = f"run {run.run}: {kind} of {file}"
        sizes = {"picture": (WIDEST, QUALITY), "thumb": (THUMB_WIDTH, THUMB_QUALITY)}
        for where in ("picture", "thumb") if kind == "render" else ("picture",):
            data = to_jpeg(png, name, *sizes[where])
            write_bytes(folder / where / run.run / kind / f"{Path(file).stem}.jpg", data)
            spent += len(data)
    return spent
