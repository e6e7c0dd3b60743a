"""Geometry of rendered depth on a plane with a wall that only the test view sees."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import pytest
import torch

from helpers.tiny_scene import camera, tiny_scene
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.scene_scores.true_geometry import geometry_metrics, seen_by


def flat(depth: float) -> torch.Tensor:
    return torch.full((18, 24), depth)


def scene(*, test_depth: float = 4.0) -> Scene:
    """Three views 4 units before the plane; the test view may see another depth there."""
    depths = (test_depth, 4.0, 4.0)

    def view(index: int) -> View:
        load = lambda: flat(depths[index])
        return replace(tiny_scene().views[index], camera=camera(index), load_depth=load)

    return replace(tiny_scene(), views=tuple(map(view, range(3))), train=(1, 2), test=(0,))


@dataclass(frozen=True)
class Shows:
    """A model that shows a depth at every view."""

    depth: float
    alpha: float = 1.0
    primitives: int = 1

    kind: ClassVar[str] = "shows"

    def render(self, view: View, background=None) -> RenderOutput:
        del background
        size = view.size
        return RenderOutput(
            colour=torch.zeros(*size, 3), alpha=torch.full(size, self.alpha),
            depth=torch.full(size, self.depth), radii=torch.zeros(1),
        )  # fmt: skip

    def bake(self, view=None):
        pytest.fail("geometry is judged by what a model renders, not by its primitives")

    def store(self, folder):
        pytest.fail("scoring does not write models")


def test_the_truth_is_accurate_and_complete():
    found = geometry_metrics(scene(), Shows(4.0))
    assert found["geometry_accuracy"] == pytest.approx(0, abs=1e-9)
    assert found["geometry_completeness"] == found["geometry_f_score"] == 1


def test_a_surface_too_far_is_off_by_as_much():
    found = geometry_metrics(scene(), Shows(5.0))
    # rays spread: the nearest true point is straight ahead, within half a cube's diagonal
    assert 1.0 <= found["geometry_accuracy"] < 1.15
    assert found["geometry_completeness"] == 0


def test_what_is_transparent_is_no_surface():
    found = geometry_metrics(scene(), Shows(4.0, alpha=0.4))
    assert found["geometry_completeness"] == 0
    assert math.isnan(found["geometry_accuracy"])


def test_blind_is_what_only_the_test_view_sees():
    hidden = scene(test_depth=8.0)
    assert geometry_metrics(hidden, Shows(4.0))["geometry_blind_completeness"] == 0
    assert geometry_metrics(hidden, Shows(8.0))["geometry_blind_completeness"] > 0.95
    seen = geometry_metrics(scene(), Shows(4.0))["geometry_blind_completeness"]
    # only the strip beside the training views' images is blind, and found
    assert seen == 1
    with_itself = replace(scene(), train=(0, 1, 2))
    nothing = geometry_metrics(with_itself, Shows(4.0))["geometry_blind_completeness"]
    assert math.isnan(nothing)


def test_a_point_is_seen_at_its_true_depth_and_inside_the_image():
    views = scene().train_views
    points = torch.tensor([[0.0, 0, 0], [0, 0, 0.5], [0, 0, -0.5], [9, 0, 0], [0, 0, -9]])
    assert seen_by(points.double(), views).tolist() == [True, False, False, False, False]


def test_a_scene_without_truth_has_no_such_metrics():
    assert geometry_metrics(tiny_scene(), Shows(4.0)) == {}
