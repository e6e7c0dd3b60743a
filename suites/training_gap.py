"""How much better a model shows the photos that it was trained on than those that were held out."""

import statistics
from collections.abc import Sequence
from dataclasses import replace

from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.metrics.scoring import score_image
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore
from splatproof.reference.types.scene import Scene
from splatproof.suites.held_out import drawn, kept

VIEWS = 8
"""Most training views that are scored, evenly spread over their order."""


def training_gap(
    scene: Scene, model: Reconstruction, protocol: Protocol, held_out: Sequence[ImageScore]
) -> dict[str, float]:
    """PSNR of training views minus that of held-out ones: what a model learnt by heart.

    Training views are scored as the protocol scores held-out ones, at their true poses, up to VIEWS of
    them.

    Args:
        scene: The scene, opened under the protocol.
        model: What is scored.
        protocol: The rules.
        held_out: Scores of the held-out views.

    Returns: training_gap in dB by its name; empty where the protocol scores no PSNR, or training views
        themselves, or there is no training view.

    Source: StratoSplat, Sec. 3.3 and Fig. 1, which show the gap in pictures; as a number: ours.
    """
    known = [image.metrics["psnr"] for image in held_out if "psnr" in image.metrics]
    if not known or not scene.train or protocol.scored == "training":
        return {}
    rules = replace(protocol, metrics=("psnr",), parts=(), colour_fit=())
    step = -(-len(scene.train) // VIEWS)
    learnt = []
    for view in scene.train_views[::step]:
        render, _ = kept(drawn(view, scene.train_views, model, rules), rules.rounding)
        truth, _ = kept(view.load(), "float")
        mask = None if view.load_mask is None else view.load_mask()
        learnt.append(score_image(view.name, render, truth, rules, mask).metrics["psnr"])
    return {"training_gap": statistics.fmean(learnt) - statistics.fmean(known)}
