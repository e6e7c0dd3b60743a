"""`bench study memory`: layered memory (LDI) against a cloud that only grows (StratoSplat, Table 5).

Both are filled with the same dense points, view by view; then each guides the depth of the
held-out views. Truth are the sparse points that the held-out view's own track holds.
"""

import time
from collections.abc import Iterator
from typing import Any

import torch
from jaxtyping import Float
from scipy.sparse import csr_array
from torch import Tensor

from splatproof.base.errors import MissingError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.image_cache import ImageCache
from splatproof.methods.training.dense_points import match
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.layered_memory import guide_depth, layered_depth
from splatproof.reference.layered_memory.layered_depth import LayeredDepth
from splatproof.reference.supervision import dense_initialisation as dense
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene

SHARE = 0.01
"""eps_d as a share of the median depth of the sparse points in the reference view."""


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """One row a memory; the paper finds 3.6 times fewer points with no loss."""
    protocol = load_protocol("quick")
    try:
        scene = open_scene("courtyard" if quick else "brighton_beach", protocol)
    except MissingError:
        scene = open_scene("courtyard", protocol)
    seen = dense.observations(scene.points, len(scene.views))
    batches = dense_batches(scene, seen, 4 if quick else 12)
    reference = int(dense.rows_of(seen, scene.train).sum(axis=1).argmax())
    camera = scene.views[scene.train[reference]].camera
    held = scene.points.positions[dense.points_of(seen, scene.train[reference])]
    eps = SHARE * float(project_points(camera, held)[1].median())
    for name, distance in (("layered", eps), ("accumulated", 1e-12)):
        start = time.perf_counter()
        memory = layered_depth.empty(camera, distance, 10_000 if name == "accumulated" else 8)
        for batch in batches:
            memory = layered_depth.insert(memory, batch.positions, batch.colours)
        error, covered = guide_error(scene, seen, memory)
        yield {
            "scene": scene.name, "memory": name, "points": len(memory), "guide_error": error,
            "covered": covered, "eps_d": distance, "forced": memory.forced,
            "ms": 1e3 * (time.perf_counter() - start),
        }  # fmt: skip


def dense_batches(scene: Scene, seen: csr_array, most: int) -> list[dense.DensePoints]:
    """Dense points of pairs of training views, the most co-visible pairs first.

    Args:
        scene: A scene with tracks.
        seen: Which view of the scene sees which point, views x points.
        most: Number of pairs that are matched, at most.

    Returns: The points of each pair, apart.
    """
    settings = dense.DenseSettings()
    trained = dense.rows_of(seen, scene.train)
    centres = torch.stack([scene.views[i].camera.centre for i in scene.train])
    pairs = dense.select_pairs(centres, scene.points.positions, trained, settings)
    shared = {pair: dense.seen_by_both(trained, *pair) for pair in pairs}
    order = sorted(pairs, key=lambda pair: (-len(shared[pair]), pair))[:most]
    images = ImageCache(0)
    return [
        match(
            scene.views[scene.train[a]], scene.views[scene.train[b]],
            scene.points.positions[shared[a, b]], images, settings,
        )
        for a, b in order
    ]  # fmt: skip


def guide_error(scene: Scene, seen: csr_array, memory: LayeredDepth) -> tuple[float, float]:
    """Median relative guide-depth error over the held-out views, and the share of truths covered.

    Args:
        scene: A scene with tracks; the sparse points of a held-out view are its truth.
        seen: Which view of the scene sees which point, views x points.
        memory: The memory that guides.

    Returns: The error and the share, both in [0, 1]; the error is nan where nothing is covered.
    """
    errors: list[Float[Tensor, " m"]] = []
    truths = 0
    for index in scene.test:
        view = scene.views[index]
        guide, visible = guide_depth.render(memory, view.camera)
        at, z = project_points(view.camera, scene.points.positions[dense.points_of(seen, index)])
        size = at.new_tensor([view.camera.width, view.camera.height])
        inside = (at >= 0).all(dim=1) & (at < size).all(dim=1) & (z > 0)
        column, row = at[inside].long().unbind(dim=1)
        known = visible[row, column]
        truths += len(known)
        errors.append(((guide[row, column] - z[inside]).abs() / z[inside])[known])
    every = torch.cat(errors) if errors else torch.zeros(0)
    if not len(every):
        return float("nan"), 0.0
    return float(every.median()), len(every) / truths
