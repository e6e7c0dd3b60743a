"""`bench study seen`: which pixels a training photo can have shown, from sparse points and from true depth.

Scores on what is seen (docs/seen.md) rest on true depth in made worlds alone. Elsewhere sparse points
say how deep a view is, and nothing says what stands before it. Here both are asked of the same views.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool
from torch import Tensor

from splatproof.base.errors import MissingError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.seen import seen_in_training
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.gallery.drawing import panels, save, show_image

CASES = (
    ("courtyard", "quick"), ("street", "street"), ("tunnel", "tunnel"),
    ("brighton_beach", "quick"), ("seneca", "city_400"), ("caliterra", "city_400"),
)  # fmt: skip
"""Scenes and the protocols that say what is held out; one that is not here is noted."""
LEAST = 0.99
"""Protocol.least_seen of the split that leaves the rim to training, as in default_seen.toml."""
QUICK = 1
"""Cases of the reduced form."""
UNSEEN = (0.85, 0.1, 0.1)
"""Colour that is laid over what no photo shows, sRGB."""
SHOWN = 4
"""Views of a scene in its picture: those of which least is seen."""
Row = dict[str, Any]


def rows(*, quick: bool) -> Iterator[Row]:
    """One row a scene: shares of pixels, means over its held-out views."""
    for name, protocol in CASES[:QUICK] if quick else CASES:
        row: Row = {"scene": name, "protocol": protocol}
        try:
            yield (
                row
                | scene_row(open_scene(name, load_protocol(protocol)))
                | rule_row(name, protocol)
            )
        except MissingError as error:
            yield row | {"note": str(error)}


def scene_row(scene: Scene) -> Row:
    """What is seen of a scene's held-out views by either source of depth, and where they disagree.

    Args:
        scene: Any; without true depth the truth's columns are missing.
    """
    points = {n: m for n, m in seen_in_training(without_depth(scene)).items() if m is not None}
    row: Row = {"views": len(scene.test)}
    if points:
        row["seen_by_points"] = _mean([_share(mask) for mask in points.values()])
    if all(view.load_depth is not None for view in scene.views):
        truth = {n: m for n, m in seen_in_training(scene).items() if m is not None}
        both = [(truth[name], points[name]) for name in points]
        row["seen_in_truth"] = _mean([_share(mask) for mask in truth.values()])
        row["called_unseen_wrongly"] = _mean([_share(true & ~said) for true, said in both])
        row["called_seen_wrongly"] = _mean([_share(~true & said) for true, said in both])
    return row


def rule_row(name: str, protocol: str) -> Row:
    """What is seen of the held-out views that `least_seen` chooses, where a protocol counts views.

    Args:
        name: Scene.
        protocol: Its other rules stay. One that counts moments has no such choice: no columns.
    Returns: `least_seen` of the worst view as the protocol is; how many views the rule holds out,
        and the same of its worst and the mean over all.
    """
    rules = load_protocol(protocol)
    if rules.hold_unit != "view" or not rules.hold:
        return {}
    before = _shares(open_scene(name, rules))
    after = _shares(open_scene(name, replace(rules, name=f"{protocol}_seen", least_seen=LEAST)))
    return {
        "least_seen": min(before), "views_by_rule": len(after),
        "least_by_rule": min(after), "seen_by_rule": _mean(after),
    }  # fmt: skip


def _shares(scene: Scene) -> list[float]:
    return [_share(mask) for mask in seen_in_training(scene).values() if mask is not None]


def without_depth(scene: Scene) -> Scene:
    """The scene as if its true depth were not known."""
    return replace(scene, views=tuple(replace(view, load_depth=None) for view in scene.views))


def draw(found: Sequence[Row], folder: Path) -> list[Path]:
    """A picture a scene: the held-out views of which least is seen, what no photo shows in red.

    Args:
        found: Rows of the study.
        folder: Folder of the pictures.
    """
    drawn = []
    for row in (row for row in found if "note" not in row):
        scene = open_scene(row["scene"], load_protocol(row["protocol"]))
        masks = {name: mask for name, mask in seen_in_training(scene).items() if mask is not None}
        views = sorted(
            (view for view in scene.test_views if view.name in masks),
            key=lambda view: (_share(masks[view.name]), view.name),
        )[:SHOWN]
        if views:
            drawn.append(folder / f"seen_{row['scene'].replace('/', '-')}.png")
            _draw(views, masks, drawn[-1])
    return drawn


def _draw(views: Sequence[View], masks: Mapping[str, Bool[Tensor, "h w"]], path: Path) -> None:
    ratio = views[0].size[0] / views[0].size[1]
    figure, axes = panels(len(views), width=3.2 * len(views), ratio=ratio)
    for place, view in zip(axes, views, strict=True):
        image, seen = view.load().numpy(), masks[view.name].numpy()
        shown = np.where(seen[..., None], image, 0.35 * image + 0.65 * np.array(UNSEEN))
        show_image(place, shown, f"{view.name}: {100 * seen.mean():.1f} % seen")
    save(figure, path)


def _share(mask: Bool[Tensor, "h w"]) -> float:
    return float(mask.double().mean())


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
