"""What a model learnt by heart: known errors on known views, and when nothing can be said."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import tiny_scene
from splatproof.methods.contracts.reconstruction import Stored
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.result import ImageScore
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.training_gap import VIEWS, training_gap

RULES = load_protocol("float")


@dataclass
class Off:
    """Renders the truth off by a number of its own for each view, and notes which were asked for."""

    truths: dict[bytes, Tensor]
    by: dict[bytes, float]
    primitives: int = 1

    kind: str = "off"

    def store(self, folder: Path) -> Stored:
        raise AssertionError("nothing is saved here")

    def render(self, view: View, background: Tensor | None = None) -> RenderOutput:
        del background
        key = view.camera.world_to_camera.numpy().tobytes()
        image = self.truths[key] + self.by[key]
        flat = torch.zeros(image.shape[:2])
        return RenderOutput(colour=image, alpha=flat, depth=flat, radii=torch.zeros(1))


def scene_of(views: int) -> Scene:
    """Grey photos, so that an error of 0.1 stays within the range."""
    scene = tiny_scene(views=views)
    grey = partial(torch.full, (18, 24, 3), 0.5)
    return replace(scene, views=tuple(replace(view, load=grey) for view in scene.views))


def model_of(scene: Scene, error: float) -> Off:
    keys = [view.camera.world_to_camera.numpy().tobytes() for view in scene.views]
    return Off(
        {key: view.load() for key, view in zip(keys, scene.views, strict=True)},
        dict.fromkeys(keys, error),
    )


def score(**values: float) -> ImageScore:
    return ImageScore(name="0.png", truth_sha256="", valid_share=1.0, metrics=values)


def held(psnr: float) -> ImageScore:
    return score(psnr=psnr)


@pytest.mark.parametrize("views", [2, 6, 30])
def test_the_gap_is_the_difference_of_the_means(views):
    scene = scene_of(views)
    model = model_of(scene, 0.1)  # 20 dB
    found = training_gap(scene, model, RULES, [held(14.0), held(16.0)])
    assert found["training_gap"] == pytest.approx(5.0, abs=1e-3)


def test_the_held_out_view_does_not_count_and_few_are_asked_for():
    scene = scene_of(30)
    model = model_of(scene, 0.1)
    model.by[scene.test_views[0].camera.world_to_camera.numpy().tobytes()] = 0.4
    asked: list[bytes] = []
    whole = model.render

    def noted(view: View, background: Tensor | None = None) -> RenderOutput:
        asked.append(view.camera.world_to_camera.numpy().tobytes())
        return whole(view, background)

    model.render = noted
    assert training_gap(scene, model, RULES, [held(20.0)])["training_gap"] == pytest.approx(
        0.0, abs=1e-3
    )
    assert 1 < len(asked) <= VIEWS


def test_nothing_is_said_where_there_is_nothing_to_compare():
    scene = scene_of(3)
    model = model_of(scene, 0.1)
    assert training_gap(scene, model, RULES, []) == {}
    assert training_gap(scene, model, replace(RULES, scored="training"), [held(20.0)]) == {}
    assert training_gap(scene, model, RULES, [score(flip=0.1)]) == {}
    assert training_gap(replace(scene, train=()), model, RULES, [held(20.0)]) == {}
