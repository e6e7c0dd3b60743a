"""Bytes of a trained model against what they cost: rate-distortion curves of formats, measured."""

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import torch

from splatproof.base.errors import MissingError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.compression.thinning import Way, thinned
from splatproof.methods.compression.tuning import TuneSettings, tuned
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import get_method
from splatproof.methods.storage.packed.coded_writer import QUALITIES, CodeSettings, chosen_steps
from splatproof.methods.storage.packed.rows import MemoryRows
from splatproof.methods.storage.packed.writer import PARTS
from splatproof.metrics.pixel import psnr
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.scoring import scene_metrics, score_image
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.studies.size_formats import Format, coded_format, formats

SCENES = (("brighton_beach", "brighton_250", None), ("courtyard", "default", None),
          ("seneca", "default", 250))  # fmt: skip
"""Name, protocol and width in pixels; those that this machine has."""
STEPS, QUICK_STEPS = 1500, 100
VIEWS = 10
"""Training views, evenly spaced, that losses are counted on; and held-out ones, where there are more."""
PRUNED = (0.1, 0.2)
"""Shares of the Gaussians, those of the least blending weight over the training views."""
MERGED = (0.1, 0.2, 0.3, 0.5)
"""Shares of the Gaussians that go as pairs become one."""
TUNED = ((0.3, "coarse"), (0.5, "coarse"))
"""Share that is merged and quality of the file, of models that are trained through its steps."""
FEW = 200
"""Gaussians of the file that warms a format up."""


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """One row a scene and format, of a model trained for it.

    Args:
        quick: One scene that every machine has, few steps and no training views.
    """
    for name, rules, width in (("courtyard", "quick", None),) if quick else SCENES:
        protocol = load_protocol(rules)
        if width is not None:
            protocol = replace(protocol, width=width, name=f"{rules}-{width}px")
        try:
            scene = open_scene(name, protocol)
        except MissingError as error:
            yield {"scene": name, "format": "", "note": str(error)}
            continue
        yield from _scene_rows(scene, protocol, quick)


def _scene_rows(scene: Scene, protocol: Protocol, quick: bool) -> Iterator[dict[str, Any]]:
    """The rows of one scene."""
    method, steps = get_method("3dgs"), QUICK_STEPS if quick else STEPS
    fitted = method.fit(scene, method.settings(iterations=steps), Run(seed=0))
    assert isinstance(fitted, ExplicitModel)
    base = quality(scene, fitted, fitted.model, protocol)
    seen = () if quick else spaced(scene.train_views)
    base_seen = seen_quality(seen, fitted, fitted.model, protocol)
    kinds = iter(formats())
    if not quick:
        kinds = chain(kinds, smaller_formats(scene, fitted, protocol))
    with tempfile.TemporaryDirectory() as folder:
        for kind in kinds:
            found = row(kind, scene, fitted, base["psnr"], protocol, Path(folder) / "model", seen)
            if "psnr_seen" in found:
                found["seen_change"] = found["psnr_seen"] - base_seen
            yield {"scene": scene.name, "steps": steps, "psnr": base["psnr"]} | found


def row(
    kind: Format,
    scene: Scene,
    fitted: ExplicitModel,
    base: float,
    protocol: Protocol,
    path: Path,
    seen: Sequence[View] = (),
) -> dict[str, Any]:
    """Size, times and loss of one format. Times are of one run after a file of few Gaussians.

    Args:
        kind: Format that the model is stored in.
        scene: Scene whose held-out views are rendered.
        fitted: Model as it was trained.
        base: PSNR in dB of the trained model against the photos; the loss is counted from it.
        protocol: Rules that the scene was opened under.
        path: File to write the model to.
        seen: Training views that are rendered too.
    """
    count = fitted.primitives
    few = Gaussians(**{name: values[:FEW] for name, values in vars(fitted.model).items()})
    try:
        _there_and_back(kind, few, path)
        parts, back, written, read = _there_and_back(kind, fitted.model, path)
    except MissingError as error:
        return {"format": kind.name, "curve": kind.curve, "primitives": count, "note": str(error)}
    size = path.stat().st_size
    found = quality(scene, fitted, back, protocol)
    after = {"psnr_seen": seen_quality(seen, fitted, back, protocol)} if seen else {}
    return {
        "format": kind.name, "curve": kind.curve, "primitives": count, "bytes": size,
        "bytes_each": size / count, "psnr_change": found["psnr"] - base,
        "psnr_to_model": found["to_model"], "write_s": written, "read_s": read,
        "write_millions_s": count / written / 1e6, "read_millions_s": count / read / 1e6,
        **{name: parts[name] / count for name in PARTS if name in parts}, **after,
    }  # fmt: skip


def _there_and_back(
    kind: Format, model: Gaussians, path: Path
) -> tuple[Mapping[str, int], Gaussians, float, float]:
    """Bytes by part, what comes back, and the seconds of each way."""
    start = time.perf_counter()
    parts = kind.write(path, model)
    written = time.perf_counter() - start
    start = time.perf_counter()
    back = kind.read(path)
    return parts, back, written, time.perf_counter() - start


def quality(
    scene: Scene, fitted: ExplicitModel, model: Gaussians, protocol: Protocol
) -> dict[str, float]:
    """Mean PSNR over the held-out views, to the photos and to the renders of the trained model.

    Args:
        scene: Scene whose held-out views are rendered.
        fitted: Model as it was trained.
        model: Gaussians as they came back from storage.
        protocol: Rules that the scene was opened under; its background is used.
    """
    stored = ExplicitModel(model=model, mode=fitted.mode)
    background = torch.tensor(protocol.background)
    scores, same = [], []
    for view in spaced(scene.test_views):
        image = stored.render(view, background).colour
        whole = fitted.render(view, background).colour
        scores.append(score_image(view.name, image, view.load(), protocol))
        same.append(float(psnr(image.clamp(0, 1), whole.clamp(0, 1))))
    return {"psnr": scene_metrics(scores)["psnr"], "to_model": sum(same) / len(same)}


def spaced(views: Sequence[View]) -> Sequence[View]:
    """VIEWS of the views or a few less, evenly spaced.

    Args:
        views: Any number of views.
    """
    return views[:: -(-len(views) // VIEWS) or 1]


def seen_quality(
    views: Sequence[View], fitted: ExplicitModel, model: Gaussians, protocol: Protocol
) -> float:
    """Mean PSNR in dB over training views, to the photos; 0 without views.

    Args:
        views: Training views.
        fitted: Model as it was trained.
        model: Gaussians as they came back from storage.
        protocol: Rules that the scene was opened under; its background is used.
    """
    stored = ExplicitModel(model=model, mode=fitted.mode)
    background = torch.tensor(protocol.background)
    found = [
        float(psnr(stored.render(view, background).colour.clamp(0, 1), view.load()))
        for view in views
    ]
    return sum(found) / max(len(found), 1)


def smaller_formats(scene: Scene, fitted: ExplicitModel, protocol: Protocol) -> Iterator[Format]:
    """Our small file of the model with fewer Gaussians, and trained through the file's steps.

    Args:
        scene: Scene that the model was trained on.
        fitted: Model as it was trained.
        protocol: Rules that the scene was opened under; its background is used.
    """
    ways: tuple[tuple[str, Way, tuple[float, ...]], ...] = (
        ("pruned", "prune", PRUNED), ("merged", "merge", MERGED),
    )  # fmt: skip
    for word, way, shares in ways:
        for share in shares:
            yield coded_format(
                f"{word} {share}", CodeSettings(), _thinned(scene, fitted, share, way), curve=word
            )
    for share, quality in TUNED:
        settings = QUALITIES[quality]
        few = _thinned(scene, fitted, share, "merge")
        steps = chosen_steps(MemoryRows(few), settings)
        run = Run(background=protocol.background)
        last = tuned(few, scene, steps, TuneSettings(), run, fitted.mode)
        yield coded_format(f"tuned {share}, {quality}", settings, last, steps, curve="tuned")


def _thinned(scene: Scene, fitted: ExplicitModel, share: float, way: Way) -> Gaussians:
    """The model with a share of its Gaussians less."""
    draw = torch.Generator().manual_seed(0)
    model, views = fitted.model, scene.train_views
    return thinned(model, views, share, generator=draw, way=way, mode=fitted.mode)
