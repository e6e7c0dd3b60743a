"""`bench study priors`: how good each depth prior is against the truth of the worlds street and tunnel.

A prior leaves scale and zero open, so each view's disparity is first brought to the true one by the
robust fit of `methods.priors.alignment`; what is left is the prior's error. Pixels without true
depth or prior do not count. Only training views have priors.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from scipy.stats import rankdata
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.fingerprint import files_sha256
from splatproof.methods.priors.alignment import aligned
from splatproof.methods.priors.attach import with_priors
from splatproof.methods.priors.kinds import KINDS
from splatproof.methods.priors.oracle import prior_of
from splatproof.metrics.depth import depth_errors
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import DepthPrior, Scene, View
from splatproof.suites.gallery.drawing import panels, save, show_image

SCENES = ("street", "tunnel")
QUICK_VIEWS = 5
"""Training views of the reduced form: the first ones, which are neighbours."""
FURTHEST = 2.0
"""Depths beyond this many times the furthest true one count as this: a shift can take disparity to 0."""
Row = dict[str, Any]


def rows(*, quick: bool) -> Iterator[Row]:
    """One row a scene and kind that needs no weights, means over views; what a scene lacks is noted."""
    for name in SCENES[:1] if quick else SCENES:
        for row in scene_rows(studied(name, quick)):
            yield row | {"quick": quick}


def studied(name: str, quick: bool) -> Scene:
    """The scene with the training views that the study looks at.

    Args:
        name: Registered name of the scene.
        quick: Whether it is the reduced form.
    """
    scene = open_scene(name, load_protocol("default"))
    return replace(scene, train=scene.train[:QUICK_VIEWS]) if quick else scene


def scene_rows(scene: Scene) -> Iterator[Row]:
    """The rows of one scene.

    Args:
        scene: A scene with true depth.
    """
    for kind in (name for name, kind in KINDS.items() if not kind.weights):
        try:
            given = with_priors(scene, kind, 0, files_sha256(scene, {}))
        except UsageError as error:
            yield {"scene": scene.name, "prior": kind, "note": str(error)}
            continue
        found = [row for view in given.train_views if (row := view_row(view))]
        means = {name: float(np.mean([row[name] for row in found])) for name in found[0]}
        yield {"scene": scene.name, "prior": kind, "views": len(found)} | means


def view_row(view: View) -> dict[str, float]:
    """Errors of one view's prior after alignment; empty where it says nothing.

    Args:
        view: A view with prior and true depth.
    Returns: abs_rel and delta1 (Eigen et al. 2014), rank (Spearman's correlation with the true
        disparity), and valid, the share of pixels that the prior says anything of.
    """
    assert view.load_prior is not None
    assert view.load_depth is not None
    prior, depth = view.load_prior(), view.load_depth()
    known = prior.valid & depth.isfinite() & (depth > 0)
    said = in_truth(prior, depth, known)
    if said is None:
        return {}
    far = FURTHEST * float(depth[known].max())
    errors = depth_errors(1 / said.clamp(min=1 / far), depth, known)
    ranks = [rankdata(values[known].numpy()) for values in (prior.disparity, 1 / depth)]
    return {
        "abs_rel": errors["abs_rel"], "delta1": errors["delta1"],
        "rank": float(np.corrcoef(ranks)[0, 1]), "valid": float(prior.valid.float().mean()),
    }  # fmt: skip


def in_truth(
    prior: DepthPrior, depth: Float[Tensor, "h w"], known: Bool[Tensor, "h w"]
) -> Float[Tensor, "h w"] | None:
    """The prior's disparity with the scale and zero that bring it nearest to the truth.

    Args:
        prior: What is aligned.
        depth: True z-depth.
        known: Pixels that count.
    Returns: Disparity; None where the pixels do not determine them.
    """
    fit = aligned(prior.disparity[known], 1 / depth[known])
    return None if fit is None else fit[0] * prior.disparity + fit[1]


def draw(found: Sequence[Row], folder: Path) -> list[Path]:
    """A picture a scene: a photo, its true disparity and every prior's, aligned; grey is unknown.

    Args:
        found: Rows of the study.
        folder: Folder of the pictures.
    """
    drawn = []
    for name in dict.fromkeys(row["scene"] for row in found):
        of_scene = [row for row in found if row["scene"] == name and "abs_rel" in row]
        scene = studied(name, of_scene[0]["quick"])
        middle = scene.train[len(scene.train) // 2]
        data = files_sha256(scene, {})
        priors = {
            row["prior"]: with_priors(scene, row["prior"], 0, data).views[middle]
            for row in of_scene
        }
        drawn.append(folder / f"priors_{name}.png")
        _draw(scene.views[middle], priors, drawn[-1])
    return drawn


def _draw(view: View, priors: Mapping[str, View], path: Path) -> None:
    assert view.load_depth is not None
    depth = view.load_depth()
    truth = prior_of(depth)
    count = 2 + len(priors)
    figure, axes = panels(count, width=3.2 * count, ratio=view.size[0] / view.size[1])
    show_image(axes[0], view.load().numpy(), view.name)
    high = float(truth.disparity.quantile(0.99))
    _show(axes[1], truth.disparity, truth, "true disparity", high)
    for place, (name, given) in zip(axes[2:], priors.items(), strict=True):
        assert given.load_prior is not None
        prior = given.load_prior()
        said = in_truth(prior, depth, prior.valid & depth.isfinite())
        title = f"{name}: AbsRel {view_row(given).get('abs_rel', math.nan):.3f}"
        _show(place, prior.disparity if said is None else said, prior, title, high)
    save(figure, path)


def _show(
    axes: Axes, disparity: Float[Tensor, "h w"], prior: DepthPrior, title: str, high: float
) -> None:
    shown = np.ma.masked_array(disparity.numpy(), ~prior.valid.numpy())
    axes.set_facecolor("0.6")
    show_image(axes, shown, title, vmin=0, vmax=high, cmap="turbo")
