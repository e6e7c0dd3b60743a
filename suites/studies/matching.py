"""`bench study matching`: what each matcher and threshold of the dense initialisation gives on a world of known depth.

One of them is changed at a time, the others stay at their defaults. An added point's error is how far
its depth lies from the true one, in each training view of its track, over the true one.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.priors import own_matcher
from splatproof.methods.priors.attach import with_priors
from splatproof.methods.priors.kinds import KINDS
from splatproof.methods.priors.unet import domain
from splatproof.methods.training.dense_points import chosen_pairs, with_dense_points
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.supervision.dense_initialisation import (
    DenseSettings,
    observations,
    points_of,
)
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene

SCENES = ("courtyard", "city")
"""The reduced form takes the first."""
CELL = 4.0
"""Pixels that points lie apart: method dpgs's default."""
IMAGE_BYTES = 2**29
QUICK_VIEWS = 6
"""Training views of the reduced form: the first ones, which are neighbours."""
WRONG = 0.05
"""Share of the true depth beyond which a point is called wrong."""
SWEEP: dict[str, tuple[float, ...]] = {
    "certainty": (0.1, 0.3, 0.5, 0.7),
    "sigma": (0.5, 1.0, 2.0, 4.0),
    "score": (0.1, 0.3, 0.5, 0.7),
    "partners": (1, 2, 4, 8),
}
"""Values of each threshold; the defaults are among them."""
PRIORS = ("own", "sweep", "oracle")
"""Depth priors that match in place of optical flow; the last is a bound on all matchers."""
Row = dict[str, Any]


def rows(*, quick: bool, roma: Path | None = None) -> Iterator[Row]:
    """The defaults, then other matchers, then each other value of each threshold.

    Args:
        quick: Few views of one scene, and the two ends of each sweep.
        roma: Folder of RoMa's weights, which then matches too.
    """
    for name in SCENES[:1] if quick else SCENES:
        scene = open_scene(name, load_protocol("default"))
        if quick:
            scene = replace(scene, train=scene.train[:QUICK_VIEWS])
        for row in _of_scene(scene, roma):
            yield {"scene": name} | row
        for threshold, values in SWEEP.items():
            for value in (values[0], values[-1]) if quick else values:
                if value != getattr(DenseSettings(), threshold):
                    change: dict[str, Any] = {threshold: value}
                    moved = replace(DenseSettings(), **change)
                    row = {"scene": name, "threshold": threshold, "value": value}
                    yield row | quality(scene, moved)


def _of_scene(scene: Scene, roma: Path | None) -> Iterator[Row]:
    """The defaults, which match by optical flow, and other matchers."""
    yield {"threshold": "defaults"} | quality(scene, DenseSettings())
    for prior in PRIORS:
        row = {"threshold": "matcher", "value": f"prior {prior}"}
        shipped = KINDS[prior].shipped
        if shipped is not None:
            row["domain"] = domain(scene, shipped)
        yield row | quality(with_priors(scene, prior, seed=0), DenseSettings(matcher="prior"))
    row = {"threshold": "matcher", "value": "own", "domain": domain(scene, own_matcher.SHIPPED)}
    yield row | quality(scene, DenseSettings(matcher="own"))
    if roma is not None:
        settings = DenseSettings(matcher="roma", weights=str(roma))
        yield {"threshold": "matcher", "value": "roma"} | quality(scene, settings)


def quality(scene: Scene, settings: DenseSettings) -> Row:
    """Number of added points, and how far they are from the surfaces.

    Args:
        scene: A made world with its truth.
        settings: Thresholds.
    Returns: pairs of photos, points, points_a_pair, median_error and wrong (both over the true depth, in
        per cent), seconds; what needs a pair or a point is missing where there is none.
    """
    started = time.perf_counter()
    dense = with_dense_points(scene, CELL, IMAGE_BYTES, settings)
    seconds = time.perf_counter() - started
    found = errors(dense, first=len(scene.points))
    pairs, points = len(chosen_pairs(scene, settings)), len(dense.points) - len(scene.points)
    row: Row = {"pairs": pairs, "points": points, "seconds": seconds}
    if pairs:
        row["points_a_pair"] = points / pairs
    if len(found):
        row["median_error"] = 100 * float(found.median())
        row["wrong"] = 100 * float((found > WRONG).double().mean())
    return row


def errors(scene: Scene, *, first: int = 0) -> Float[Tensor, " n"]:
    """|z - true z| / true z of every point in every training view of its track.

    What projects beside the image, or where nothing was hit, does not count.

    Args:
        scene: A made world with its truth.
        first: Row of the first point that counts.
    """
    seen, found = observations(scene.points, len(scene.views)), []
    for index in scene.train:
        view = scene.views[index]
        assert view.load_depth is not None
        rows_ = points_of(seen, index)
        at, z = project_points(view.camera, scene.points.positions[rows_[rows_ >= first]].double())
        column, row = at.floor().long().unbind(dim=1)
        inside = (z > 0) & (column >= 0) & (column < view.camera.width)
        inside &= (row >= 0) & (row < view.camera.height)
        truth = view.load_depth()[row[inside], column[inside]].double()
        known = truth.isfinite() & (truth > 0)
        found.append(((z[inside] - truth).abs() / truth)[known])
    return torch.cat(found) if found else torch.zeros(0, dtype=torch.float64)
