"""Make docs/city.md: python docs/tools/make_city_page.py RUNS

Reads the records of `bench run city --out RUNS` and of `bench run city-short --out RUNS`, whichever are
there, and writes docs/city.json, docs/city_short.json, docs/images/city/*.jpg and the page, with
docs/city_findings.md in it, which is written by hand. Without RUNS the page is made again from these
files and the pictures that are there. Rows that RUNS lacks are kept as they were committed.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import torch
from city_page import render_city, row_of
from kept_rows import Picture, committed, joined, pictures_of

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.city.model import CityModel
from splatproof.methods.city.regions import nearest_region
from splatproof.methods.loading import load_reconstruction
from splatproof.suites.held_out import picture_name
from splatproof.suites.records import read_record
from splatproof.suites.scene_scores.seams import COLOURS
from splatproof.suites.suite_files import Case, load_suite

FOLDER = Path(__file__).parents[1]
ROWS, PAGE, LIST = FOLDER / "city.json", FOLDER / "city.md", FOLDER / "city_pictures.json"
FINDINGS = FOLDER / "city_findings.md"
SHORT, SHORT_LIST = FOLDER / "city_short.json", FOLDER / "city_short_pictures.json"
IMAGES = FOLDER / "images" / "city"
QUALITY = 88
HEIGHT = 300
"""Pixels that pictures are enlarged to."""
ZOOM = 72
"""Side of the part of a view that is shown enlarged at a seam, in pixels."""
MERGES = ("stitchgs@hard", "stitchgs@merge", "stitchgs@gcr", "stitchgs@walls", "stitchgs")
SHORT_ROWS = (
    "3dgs", "citygaussian", "stitchgs@hard", "stitchgs@merge", "stitchgs@hard-gcr", "stitchgs@gcr",
)  # fmt: skip
PARTITIONS = ("citygaussian", "vastgaussian", "blockgaussian", "dpgs-partition")


def page() -> str:
    """The page from the committed rows and list of pictures."""
    rows, short = (json.loads(path.read_text(encoding="utf-8")) for path in (ROWS, SHORT))
    pictures, few = (
        [Picture(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))]
        for path in (LIST, SHORT_LIST)
    )
    findings = FINDINGS.read_text(encoding="utf-8")
    return render_city(rows, pictures, findings, short=short, short_pictures=few)


def cases(runs: Path, suite: str = "city") -> dict[tuple[str, str], tuple[Case, Path]]:
    """Finished cases of seed 0 by scene and row, in the suite's order."""
    found = {}
    for case in load_suite(suite).cases:
        folder = runs / suite / case.folder
        if (folder / "record.json").exists() and not read_record(folder).error and case.seed == 0:
            found[case.scene_name, case.row] = (case, folder)
    return found


def records(runs: Path, suite: str) -> list[dict]:
    """One row a record."""
    folders = [path.parent for path in (runs / suite).rglob("record.json")]
    return [row_of(read_record(folder)) for folder in folders]


def load(path: Path) -> np.ndarray:
    """A PNG as BGR."""
    picture = cv2.imread(str(path))
    assert picture is not None, path
    return picture


def labelled(picture: np.ndarray, text: str, height: int = HEIGHT) -> np.ndarray:
    """The picture at a height, with a line of text above."""
    scale = height / picture.shape[0]
    kind = cv2.INTER_NEAREST if scale > 1.5 else cv2.INTER_AREA
    big = cv2.resize(picture, (round(picture.shape[1] * scale), height), interpolation=kind)
    bar = np.full((26, big.shape[1], 3), 255, dtype=np.uint8)
    cv2.putText(bar, text, (4, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([bar, big])


def save(name: str, tiles: list[np.ndarray]) -> str:
    """Tiles side by side as a JPEG; its path from the page."""
    gap = np.full((tiles[0].shape[0], 6, 3), 255, dtype=np.uint8)
    row = np.hstack([part for tile in tiles for part in (tile, gap)][:-1])
    IMAGES.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(IMAGES / name), row, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return f"images/city/{name}"


def seam_place(folder: Path, view: str) -> tuple[int, int]:
    """Upper left corner of the square of a view that holds most seam pixels."""
    render, seams = load(folder / "renders" / view), load(folder / "seams" / view)
    mask = (np.abs(render.astype(int) - seams).sum(axis=2) > 30).astype(np.float32)
    held = cv2.boxFilter(mask, -1, (ZOOM, ZOOM), normalize=False, borderType=cv2.BORDER_CONSTANT)
    half = ZOOM // 2
    inner = held[half : mask.shape[0] - half, half : mask.shape[1] - half]
    top, left = np.unravel_index(int(inner.argmax()), inner.shape)
    return int(top), int(left)


def map_of(case: Case, folder: Path) -> np.ndarray:
    """The scene's sparse points from above, each in the colour of the region that owns it."""
    model = load_reconstruction(folder / "model")
    assert isinstance(model, CityModel)
    scene = open_scene(case.scene, case.protocol)
    owner = nearest_region(model.regions, scene.points.positions)
    up = scene.up / scene.up.norm()
    side = torch.linalg.svd(up[None])[2][1:]
    at = (scene.points.positions @ side.T).numpy()
    low, high = np.quantile(at, [0.01, 0.99], axis=0)
    size = 420
    place = ((at - low) / (high - low).max() * (size - 1)).round().astype(int)
    canvas = np.full((size, size, 3), 255, dtype=np.uint8)
    inside = ((place >= 0) & (place < size)).all(axis=1)
    for (x, y), block in zip(place[inside], owner[torch.from_numpy(inside)].tolist(), strict=True):
        cv2.circle(canvas, (int(x), int(y)), 1, COLOURS[block % len(COLOURS)][::-1], -1)
    return canvas


def pictures(runs: Path) -> list[Picture]:
    """Draw all pictures."""
    found, shown = cases(runs), []
    for scene in dict.fromkeys(scene for scene, _ in found):
        name = scene.replace("/", "_")
        maps = [r for r in PARTITIONS if (scene, r) in found]
        if maps:
            path = save(
                f"{name}_partitions.jpg", [labelled(map_of(*found[scene, r]), r) for r in maps]
            )
            shown.append(Picture(path=path, caption=f"{scene}: sparse points by the block that owns "
                                 "their place, from above."))  # fmt: skip
        rows = [r for r in MERGES if (scene, r) in found]
        if len(rows) < 2:
            continue
        scores = read_record(found[scene, rows[0]][1]).images
        best = max(scores, key=lambda image: image.metrics["seam_coverage"]).name
        view = picture_name(best)
        hard, last = found[scene, rows[0]][1], found[scene, rows[-1]][1]
        tiles = [
            labelled(load(last / kind / view), text)
            for kind, text in (("truth", "photo"), ("renders", rows[-1]), ("seams", "seam mask"),
                               ("blocks", "blocks"), ("errors", "FLIP error"))
        ]  # fmt: skip
        shown.append(Picture(path=save(f"{name}_view.jpg", tiles), caption=f"{scene}, test view {best}: "
                             "photo, render, seam mask of the partition, blocks, error."))  # fmt: skip
        top, left = seam_place(hard, view)
        part = np.s_[top : top + ZOOM, left : left + ZOOM]
        tiles = [labelled(load(hard / "truth" / view)[part], "photo")]
        tiles += [labelled(load(found[scene, r][1] / "renders" / view)[part], r) for r in rows]
        shown.append(Picture(path=save(f"{name}_seam.jpg", tiles), caption=f"{scene}, test view {best}, "
                             "enlarged at a seam: hard merge, then stitched, refined, walls moved, compressed."))  # fmt: skip
    return shown


def short_pictures(runs: Path) -> list[Picture]:
    """The view with most seam pixels, enlarged there: photo and all rows of suite city-short."""
    found, shown = cases(runs, "city-short"), []
    for scene in dict.fromkeys(scene for scene, _ in found):
        rows = [row for row in SHORT_ROWS if (scene, row) in found]
        hard = found[scene, "stitchgs@hard"][1]
        best = max(read_record(hard).images, key=lambda image: image.metrics["seam_coverage"]).name
        view = picture_name(best)
        top, left = seam_place(hard, view)
        part = np.s_[top : top + ZOOM, left : left + ZOOM]
        tiles = [labelled(load(hard / "truth" / view)[part], "photo")]
        tiles += [labelled(load(found[scene, r][1] / "renders" / view)[part], r) for r in rows]
        shown.append(Picture(path=save(f"{scene}_short_seam.jpg", tiles), caption=f"{scene}, test view "
                             f"{best}, enlarged at a seam of stitchgs: rows of city-short."))  # fmt: skip
    return shown


def main() -> None:
    """Write rows, pictures and page."""
    runs = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    for suite, rows, list_, draw in (
        ("city", ROWS, LIST, pictures), ("city-short", SHORT, SHORT_LIST, short_pictures),
    ):  # fmt: skip
        if runs is None or not (runs / suite).is_dir():
            continue
        every, kept = joined(records(runs, suite), committed(rows), load_suite(suite).cases)
        rows.write_text(json.dumps(every, indent=1) + "\n", encoding="utf-8")
        before = [Picture(**entry) for entry in committed(list_)] if kept else []
        drawn = [vars(picture) for picture in pictures_of(draw(runs), before, every)]
        list_.write_text(json.dumps(drawn, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
