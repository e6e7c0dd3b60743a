"""Make docs/city.md: python docs/tools/make_city_page.py RUNS

Reads the records of `bench run city --out RUNS` and writes docs/city.json, docs/images/city/*.jpg and the page,
with docs/city_findings.md in it, which is written by hand. Without RUNS the page is made again from these
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

from splatproof.cli.claim_sources import committed as committed_evidence
from splatproof.cli.claim_sources import judged
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.city.model import CityModel
from splatproof.methods.city.regions import nearest_region
from splatproof.methods.loading import load_reconstruction
from splatproof.reports.claims.claim import HOUSE, load_claims
from splatproof.reports.findings.finding import Finding
from splatproof.suites.held_out import picture_name
from splatproof.suites.published.rows import numbers
from splatproof.suites.records import read_record
from splatproof.suites.scene_scores.seams import COLOURS
from splatproof.suites.suite_files import Case, load_suite

FOLDER = Path(__file__).parents[1]
ROWS, PAGE, LIST = FOLDER / "city.json", FOLDER / "city.md", FOLDER / "city_pictures.json"
FINDINGS = FOLDER / "city_findings.md"
IMAGES = FOLDER / "images" / "city"
QUALITY = 88
HEIGHT = 300
"""Pixels that pictures are enlarged to."""
ZOOM = 72
"""Side of the part of a view that is shown enlarged at a seam, in pixels."""
EARLIER = {"refine.clean.largest_scale": 50.0}
"""A default of before that committed rows may have. The findings say what it took from city/medium and seneca."""
MERGES = {
    "": ("stitchgs@hard", "stitchgs@merge", "stitchgs@gcr", "stitchgs@walls", "stitchgs"),
    "_odbp": ("odbp+stitch@hard", "odbp+stitch", "odbp+stitch@parts", "odbp+stitch@small"),
    "_k8": ("odbp+stitch@k8-hard", "odbp+stitch@k8-small"),
    "_tuned": tuple(
        f"stitchgs@tuned{merge}-double" for merge in ("-hard", "-merge", "-hard-gcr", "-gcr", "")
    ),
    **{
        f"_{plant}": tuple(
            f"stitchgs@{plant}-{merge}" for merge in ("hard", "hard-gcr", "gcr", "fade", *last)
        )
        for plant, last in (("light", ("walls", "level")), ("place", ("walls",)))
    },
}
"""Rows from the hard cut to the last way to mend it, by the ending of their pictures' names."""
ONE, BLOCKS = "3dgs@tuned-double", "odbp+stitch@tuned-double"
"""Rows that are shown beside each other: one model and blocks of as many visible updates."""
PARTITIONS = ("citygaussian", "vastgaussian", "blockgaussian", "dpgs-partition")


def expected() -> list[Finding]:
    """This project's own claims of the suite, judged by the committed rows as the claims page does."""
    own = [claim for claim in load_claims("city", numbers()) if claim.paper == HOUSE]
    return judged(own, (), committed_evidence(FOLDER, ["city"]))


def page() -> str:
    """The page from the committed rows and list of pictures."""
    rows = json.loads(ROWS.read_text(encoding="utf-8"))
    pictures = [Picture(**entry) for entry in json.loads(LIST.read_text(encoding="utf-8"))]
    planned = [(case.scene_name, case.row) for case in load_suite("city").cases]
    findings = FINDINGS.read_text(encoding="utf-8")
    return render_city(rows, pictures, expected(), findings, planned)


def cases(runs: Path) -> dict[tuple[str, str], tuple[Case, Path]]:
    """Finished cases of seed 0 by scene and row, in the suite's order."""
    found = {}
    for case in load_suite("city").cases:
        folder = runs / "city" / case.folder
        if (folder / "record.json").exists() and not read_record(folder).error and case.seed == 0:
            found[case.scene_name, case.row] = (case, folder)
    return found


def records(runs: Path) -> list[dict]:
    """One row a record."""
    folders = [path.parent for path in (runs / "city").rglob("record.json")]
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
        for ending, merges in MERGES.items():
            rows = [row for row in merges if (scene, row) in found]
            if len(rows) > 1:
                shown += seam_pictures(
                    scene, f"{name}{ending}", {r: found[scene, r][1] for r in rows}
                )
        if (scene, ONE) in found and (scene, BLOCKS) in found:
            shown.append(beside(scene, found[scene, ONE][1], found[scene, BLOCKS][1]))
    return shown


def beside(scene: str, one: Path, blocks: Path) -> Picture:
    """The view with most seam pixels, by one model and by blocks."""
    best = most_seam(blocks)
    view = picture_name(best)
    tiles = [labelled(load(blocks / "truth" / view), "photo")]
    for folder, text in ((one, ONE), (blocks, BLOCKS)):
        tiles += [
            labelled(load(folder / "renders" / view), text),
            labelled(load(folder / "errors" / view), "its FLIP error"),
        ]
    tiles.append(labelled(load(blocks / "seams" / view), "seam mask"))
    return Picture(
        path=save(f"{scene.replace('/', '_')}_beside.jpg", tiles),
        caption=f"{scene}, test view {best}: photo, {ONE} and its error, {BLOCKS} and its error, seam mask.",
    )


def most_seam(folder: Path) -> str:
    """The view of a row that shows most seam pixels."""
    return max(
        read_record(folder).images, key=lambda image: image.metrics["seam_coverage_partition"]
    ).name


def seam_pictures(scene: str, name: str, rows: dict[str, Path]) -> list[Picture]:
    """The view with most seam pixels: whole as the last row shows it, and each row enlarged at the seam."""
    folders = list(rows.values())
    hard, last = folders[0], folders[-1]
    best = most_seam(hard)
    view = picture_name(best)
    tiles = [
        labelled(load(last / kind / view), text)
        for kind, text in (("truth", "photo"), ("renders", list(rows)[-1]), ("seams", "seam mask"),
                           ("blocks", "blocks"), ("errors", "FLIP error"))
    ]  # fmt: skip
    whole = Picture(path=save(f"{name}_view.jpg", tiles), caption=f"{scene}, test view {best}: "
                    "photo, render, seam mask of the partition, blocks, error.")  # fmt: skip
    top, left = seam_place(hard, view)
    part = np.s_[top : top + ZOOM, left : left + ZOOM]
    tiles = [labelled(load(hard / "truth" / view)[part], "photo")]
    tiles += [labelled(load(folder / "renders" / view)[part], row) for row, folder in rows.items()]
    zoomed = Picture(path=save(f"{name}_seam.jpg", tiles),
                     caption=f"{scene}, test view {best}, enlarged at a seam: {', '.join(rows)}.")  # fmt: skip
    return [whole, zoomed]


def main() -> None:
    """Write rows, pictures and page."""
    if len(sys.argv) > 1:
        runs = Path(sys.argv[1])
        planned = load_suite("city").cases
        every, kept = joined(records(runs), committed(ROWS), planned, EARLIER)
        lines = ",\n".join(map(json.dumps, every))
        ROWS.write_text(f"[\n{lines}\n]\n", encoding="utf-8")
        before = [Picture(**entry) for entry in committed(LIST)] if kept else []
        drawn = [vars(picture) for picture in pictures_of(pictures(runs), before, every)]
        LIST.write_text(json.dumps(drawn, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
