"""`bench study blind`: does a small classifier that was shown hard-cut seams find those of other merges?

It looks at square crops of kept held-out renders: some where blocks meet, some where no seam is. It is trained on the
hard cut's, of other views, and asked about every merge's. 50 % is guessing. Places where blocks meet may look unlike
others by what stands there: how well it tells them apart in the *photos*, which have no seam, says how much of that is
in a figure. A figure means something only if the hard cut's own is clearly above that.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.photos import read_photo
from splatproof.methods.city.model import REGIONS
from splatproof.methods.city.regions import load_regions
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.seam_partition import partition_seam_mask
from splatproof.reference.partition.boxes import Region
from splatproof.reference.types.result import picture_name
from splatproof.reference.types.scene import Scene
from splatproof.suites.gallery.drawing import panels, save, show_image
from splatproof.suites.records import read_finished
from splatproof.suites.scene_scores.surface import surface_depth
from splatproof.suites.studies.seam_classifier import TRAINING, Crops, chance, trained

FAMILIES = (
    ("stitchgs@hard", ("stitchgs@hard-gcr", "stitchgs@gcr", "stitchgs@fade", "stitchgs@walls")),
    ("odbp+stitch@hard", ("odbp+stitch@parts", "odbp+stitch@small")),
    ("odbp+stitch@k8-hard", ("odbp+stitch@k8-small",)),
    ("stitchgs@light-hard", ("stitchgs@light-hard-gcr", "stitchgs@light-walls", "stitchgs@light-level")),
    ("stitchgs@place-hard", ("stitchgs@place-hard-gcr", "stitchgs@place-fade", "stitchgs@place-walls")),
)  # fmt: skip
"""The hard cut, and merges of the same training."""
SIDE = 32
"""Pixels along a crop."""
MOST_SEAM = 0.6
"""Share of a crop that lies on the partition's seam mask from which on it is one of a seam; those of no seam have none."""
FOLDS = 5
"""Views are told apart by classifiers that were trained on the others."""
DRAWS = 2000
"""Bootstrap draws of views."""
SHOWN = 8
"""Crops of each kind in the picture."""
SHOWN_SIDE = 96
"""Pixels along them there."""
Row = dict[str, Any]


Case = tuple[str, str, int]
"""Scene, row and seed."""


@dataclass(frozen=True, kw_only=True)
class Kept:
    """A finished case whose renders were kept."""

    protocol: str
    folder: Path


@dataclass(frozen=True, kw_only=True)
class Place:
    """The upper left corner of a crop, and whether blocks meet there."""

    view: str
    top: int
    left: int
    seam: bool


def rows(*, quick: bool, runs: Path | None) -> Iterator[Row]:
    """A row for each scene and merge whose hard cut was run, too; shares are means over crops of either kind.

    Args:
        quick: Train a tenth as long.
        runs: Folder of kept runs.

    Raises: UsageError without runs, or where none of FAMILIES is among them.
    """
    if runs is None:
        raise UsageError(
            "bench study blind: looks at kept renders; give their folder by --runs RUNS"
        )
    found = dict(_cases(runs))
    scenes = dict.fromkeys(scene for scene, _, _ in found)
    told = False
    for scene in scenes:
        for hard, merges in FAMILIES:
            seeds = sorted(seed for at, row, seed in found if (at, row) == (scene, hard))
            others = [row for row in merges if all((scene, row, seed) in found for seed in seeds)]
            if seeds and others:
                told = True
                yield from _family(scene, hard, others, seeds, found, quick)
    if not told:
        raise UsageError(
            f"{runs}: has no finished hard cut and another merge of it, with the same seeds; "
            "run suite city first (bench run city --only '*/stitchgs@*')"
        )


def draw(found: Sequence[Row], folder: Path) -> list[Path]:
    """For each scene and family the crops that the classifier was surest to be seams, merge by merge.

    Args:
        found: Rows with their "surest" crops.
        folder: Where pictures go.
    """
    paths = []
    for scene, hard in dict.fromkeys((row["scene"], row["trained_on"]) for row in found):
        own = [row for row in found if (row["scene"], row["trained_on"]) == (scene, hard)]
        figure, axes = panels(1, width=10.0, ratio=0.12 * len(own))
        strip = np.vstack([_strip(row["surest"]) for row in own])
        names = ", ".join(row["merge"] for row in own)
        show_image(axes[0], strip, f"{scene}: surest to be seams, from above: {names}")
        path = folder / f"{scene.replace('/', '_')}_{hard.replace('@', '_')}.png"
        save(figure, path)
        paths.append(path)
    return paths


def _strip(surest: Sequence[Sequence[Any]]) -> UInt8[np.ndarray, "h w 3"]:
    """Some crops side by side, enlarged; each by the path of its picture, its top and its left."""
    strip = np.full((SHOWN_SIDE, SHOWN * SHOWN_SIDE, 3), 255, dtype=np.uint8)
    for index, (path, top, left) in enumerate(surest):
        crop = (255 * read_photo(Path(path))[top : top + SIDE, left : left + SIDE]).round().byte()
        big = cv2.resize(crop.numpy(), (SHOWN_SIDE, SHOWN_SIDE), interpolation=cv2.INTER_NEAREST)
        strip[:, index * SHOWN_SIDE : (index + 1) * SHOWN_SIDE] = big
    return strip


def places(mask: Bool[np.ndarray, "h w"], view: str, generator: np.random.Generator) -> list[Place]:
    """Crops of a view, as many of a seam as of none, none of which overlaps another of its kind by more than half.

    Args:
        mask: Pixels where blocks meet.
        view: Its name.
        generator: Draws which of the more numerous kind are left out.
    """
    share = cv2.blur(mask.astype(np.float64), (SIDE, SIDE), anchor=(0, 0))
    half = SIDE // 2
    kinds: dict[bool, list[Place]] = {True: [], False: []}
    for top in range(0, mask.shape[0] - SIDE + 1, half):
        for left in range(0, mask.shape[1] - SIDE + 1, half):
            here = float(share[top, left])
            if here >= MOST_SEAM or here < 1e-9:
                kinds[here >= MOST_SEAM].append(
                    Place(view=view, top=top, left=left, seam=here >= MOST_SEAM)
                )
    count = min(len(kinds[True]), len(kinds[False]))
    drawn = [generator.permutation(len(each))[:count] for each in kinds.values()]
    return [
        each[i] for each, chosen in zip(kinds.values(), drawn, strict=True) for i in sorted(chosen)
    ]


def accuracy(
    chances: Mapping[str, Float[np.ndarray, " n"]], seams: Mapping[str, Bool[np.ndarray, " n"]]
) -> tuple[float, float, float]:
    """Share of crops that were told rightly, and its 95 % interval by bootstrap over views.

    Args:
        chances: How likely a seam each crop was called, by view.
        seams: Whether it is one, by view.
    """
    right = {view: (chances[view] > 0.5) == seams[view] for view in chances}
    names = [view for view in sorted(right) if len(right[view])]
    generator = np.random.default_rng(0)
    drawn = generator.integers(len(names), size=(DRAWS, len(names)))
    sums, counts = (
        np.array([of(right[view]) for view in names], dtype=np.float64) for of in (np.sum, len)
    )
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975]).tolist()
    return float(sums.sum() / counts.sum()), low, high


def _cases(runs: Path) -> Iterator[tuple[Case, Kept]]:
    """Every finished case in the folder that has blocks and renders."""
    for record in sorted(runs.rglob("record.json")):
        folder = record.parent
        if (folder / "renders").is_dir() and (folder / "model" / REGIONS).is_file():
            for result in read_finished(folder):
                yield (
                    (result.scene, result.row, result.seed),
                    Kept(protocol=result.protocol, folder=folder),
                )


def _family(
    name: str,
    hard: str,
    merges: Sequence[str],
    seeds: Sequence[int],
    found: Mapping[Case, Kept],
    quick: bool,
) -> Iterator[Row]:
    """The hard cut's row, then every merge's, then the photos'."""
    scene = open_scene(name, load_protocol(found[name, hard, seeds[0]].protocol))
    held = {seed: _places(scene, found[name, hard, seed].folder, seed) for seed in seeds}
    pictures = {
        row: [_crops(found[name, row, seed].folder / "renders", held[seed]) for seed in seeds]
        for row in (hard, *merges)
    }
    pictures["photos"] = [
        _crops(found[name, hard, seed].folder / "truth", held[seed]) for seed in seeds
    ]
    named = {row: torch.cat(parts) for row, parts in pictures.items()}
    every = [(seed, place) for seed in seeds for place in held[seed]]
    seams = np.array([place.seam for _, place in every])
    views = np.array([place.view for _, place in every])
    steps = TRAINING // 10 if quick else TRAINING
    chances = _chances(named[hard], named, torch.from_numpy(seams), views, steps)
    for row, said in chances.items():
        of = {view: views == view for view in dict.fromkeys(views.tolist())}
        told, low, high = accuracy(
            {view: said[own] for view, own in of.items()},
            {view: seams[own] for view, own in of.items()},
        )
        surest = [every[i] for i in np.argsort(-said) if seams[i]][:SHOWN]
        kind = "truth" if row == "photos" else "renders"
        at = {
            seed: found[name, hard if row == "photos" else row, seed].folder / kind
            for seed in seeds
        }
        yield {
            "scene": name, "trained_on": hard, "merge": row, "seeds": len(seeds), "crops": len(said),
            "told": told, "low": low, "high": high,
            "surest": [[str(at[seed] / picture_name(one.view)), one.top, one.left] for seed, one in surest],
        }  # fmt: skip


def _places(scene: Scene, folder: Path, seed: int) -> list[Place]:
    """Crops of all held-out views, by the partition that the case has."""
    regions: Sequence[Region] = load_regions(folder / "model" / REGIONS)
    generator = np.random.default_rng(seed)
    found = []
    for index in scene.test:
        view = scene.views[index]
        mask = partition_seam_mask(view.camera, surface_depth(scene, index), regions)
        found += places(mask.numpy(), view.name, generator)
    return found


def _crops(folder: Path, held: Sequence[Place]) -> Crops:
    """The crops of the pictures in a folder, in [0, 1]."""
    images = {view: read_photo(folder / picture_name(view)) for view in {one.view for one in held}}
    parts = [images[p.view][p.top : p.top + SIDE, p.left : p.left + SIDE] for p in held]
    return torch.stack(parts).permute(0, 3, 1, 2) if parts else torch.zeros(0, 3, SIDE, SIDE)


def _chances(
    shown: Crops,
    asked: Mapping[str, Crops],
    seams: Bool[Tensor, " n"],
    views: np.ndarray,
    steps: int,
) -> dict[str, Float[np.ndarray, " n"]]:
    """How likely a seam each crop of each row is called, by a classifier that has not seen its view."""
    found = {row: np.zeros(len(seams)) for row in asked}
    names = sorted(set(views.tolist()))
    for fold in range(min(FOLDS, len(names))):
        own = torch.from_numpy(np.isin(views, names[fold::FOLDS]))
        network = trained(shown[~own], seams[~own], steps=steps, seed=fold)
        for row, crops in asked.items():
            found[row][own.numpy()] = chance(network, crops[own]).numpy()
    return found
