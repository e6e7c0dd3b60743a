"""Whether photos are matched before training, judged by facts and by what a pair takes."""

import math
import time
from dataclasses import dataclass

import torch
from scipy.sparse import csr_array

from splatproof.datasets.image_cache import ImageCache
from splatproof.methods.auto.choices import NOT_MEASURED, Choice
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.measured import MATCHED, UNMATCHED
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.contracts.run import Run
from splatproof.methods.training.dense_points import match
from splatproof.reference.supervision.dense_initialisation import (
    DenseSettings,
    observations,
    rows_of,
    seen_by_both,
    select_pairs,
)
from splatproof.reference.types.scene import Scene

CELL = 4.0
"""Pixels between matched points, as in the settings chosen by hand for brighton_beach."""
LONG_TRACK = 5.0
"""Photos a point is found in, from which on matched points gain nothing. Held-out training photos, 800 to
1,200 steps, one seed: points found in 3.3 (brighton_beach), 3.6 (city) and 4.1 photos (aerial-sparse/town)
gain 0.3 to 0.4 dB; in 5.9 (courtyard), 6.0 (street) and 6.2 (caliterra) 0.1, 0.0 and -1.2 dB."""
ENOUGH = 0.7
"""Share of the points that training starts from at most, from which on matched ones are merged with those
that are there: tunnel and seneca, whose points are more, lose 0.2 dB by matching."""
SHARE = 0.15
"""Share of the seconds that matching may take."""
PARTNERS = (4, 2)
"""Photos that each photo is matched with, and fewer where that takes too long: 0.06 dB less on
brighton_beach, in three quarters of the time."""


@dataclass(frozen=True, kw_only=True)
class Matching:
    """What is decided."""

    cell: float
    """Pixels between matched points; 0: no photos are matched."""
    partners: int
    """Photos that each photo is matched with."""
    seconds: float
    """Wall seconds that it is expected to take."""
    choice: Choice
    """The decision and why."""


def planned_matching(
    scene: Scene, asked: AutoSettings, facts: SceneFacts, most_points: int | None, run: Run
) -> Matching:
    """Match photos where structure from motion found points in few photos, and there is time.

    Args:
        scene: As a method gets it.
        asked: The budget; `dense_cell` may be fixed.
        facts: What was measured.
        most_points: Most points that training starts from; None: no bound.
        run: Bound on photos in memory.

    Source: ours.
    """
    if asked.dense_cell == 0:
        return _none("given")
    if asked.dense_cell is None:
        if math.isnan(facts.track):
            return _none("nothing says which photos see the same points")
        if not facts.track < LONG_TRACK:
            return _none(
                f"a point was found in {facts.track:.1f} photos: matched points gain nothing",
                str(UNMATCHED),
            )
        if facts.points > ENOUGH * (most_points or 2 * facts.points):
            return _none(f"{facts.points:,} points are enough to start from", str(UNMATCHED))
    cell = CELL if asked.dense_cell is None else asked.dense_cell
    seen = rows_of(observations(scene.points, len(scene.views)), scene.train)
    centres = torch.stack([view.camera.centre for view in scene.train_views])
    pairs, seconds, each = [], 0.0, 0.0
    for partners in PARTNERS:
        settings = DenseSettings(partners=partners)
        pairs = select_pairs(centres, scene.points.positions, seen, settings)
        if not pairs:
            return _none("no two photos see the same points under a useful angle")
        each = each or _seconds(scene, seen, pairs[len(pairs) // 2], settings, run)
        seconds = each * len(pairs) / torch.get_num_threads()
        if seconds <= SHARE * asked.seconds or asked.dense_cell is not None:
            return Matching(
                cell=cell, partners=partners, seconds=seconds,
                choice=Choice(
                    component="matched points", value=f"about one every {cell:g} pixels",
                    because="given" if asked.dense_cell is not None
                    else f"a point was found in {facts.track:.1f} photos only",
                    expects=f"{MATCHED}, for {seconds:.0f} s: {len(pairs)} pairs of photos",
                ),
            )  # fmt: skip
    return _none(
        f"{len(pairs)} pairs of photos would take {seconds:.0f} of {asked.seconds:.0f} s",
        f"{seconds:.0f} s saved",
    )


def _none(why: str, expects: str = NOT_MEASURED) -> Matching:
    choice = Choice(component="matched points", value="none", because=why, expects=expects)
    return Matching(cell=0.0, partners=PARTNERS[0], seconds=0.0, choice=choice)


def _seconds(
    scene: Scene, seen: csr_array, pair: tuple[int, int], settings: DenseSettings, run: Run
) -> float:
    """Wall seconds of one thread for one pair, its photos read before."""
    first, second = (scene.train_views[row] for row in pair)
    shared = scene.points.positions[seen_by_both(seen, *pair)]
    images = ImageCache(run.image_bytes)
    images.load(first)
    images.load(second)
    began = time.perf_counter()
    match(first, second, shared, images, settings)
    return time.perf_counter() - began
