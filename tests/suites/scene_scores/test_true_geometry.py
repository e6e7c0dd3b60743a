"""Geometry of rendered depth on a plane with a wall that only the test view sees."""

import math
from dataclasses import dataclass, replace

import pytest
import torch

from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import DataError
from splatproof.metrics.scene_registry import SCENE_METRICS
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

    kind: str = "shows"

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


def test_depth_of_scored_views_against_the_truth():
    found = geometry_metrics(scene(), Shows(5.0))
    assert found["depth_abs_rel"] == pytest.approx(0.25)
    assert found["depth_sq_rel"] == pytest.approx(0.25)
    assert found["depth_rmse"] == pytest.approx(1.0)
    # off by exactly 1.25, which the first share leaves out
    assert [found[f"depth_delta{k}"] for k in (1, 2, 3)] == [0, 1, 1]
    assert found["depth_share"] == 1
    assert found.keys() <= SCENE_METRICS.keys()
    assert geometry_metrics(scene(), Shows(4.0))["depth_rmse"] == 0


def test_depth_is_that_of_test_views_alone_and_only_they_need_truth():
    views = tuple(replace(view, load_depth=None) for view in scene().views[1:])
    some = replace(scene(test_depth=8.0), views=(scene(test_depth=8.0).views[0], *views))
    found = geometry_metrics(some, Shows(4.0))
    assert found["depth_abs_rel"] == pytest.approx(0.5)
    assert not any(name.startswith("geometry") for name in found)
    whole = geometry_metrics(scene(test_depth=8.0), Shows(4.0))
    assert whole["depth_abs_rel"] == found["depth_abs_rel"]  # training views, at 4, do not count
    assert "geometry_f_score" in whole


def test_depth_counts_where_it_is_known_and_the_mask_is_true():
    depth, mask = flat(4.0), torch.ones(18, 24, dtype=torch.bool)
    depth[:9] = math.inf
    mask[:, :12] = False
    known = replace(scene().views[0], load_depth=lambda: depth, load_mask=lambda: mask)
    empty = replace(known, load_depth=lambda: flat(math.inf))
    of = replace(scene(), views=(known, empty, *scene().views[1:]), train=(2,), test=(0, 1))
    found = geometry_metrics(of, Shows(5.0))
    assert found["depth_rmse"] == pytest.approx(1.0)  # the empty view has no say
    assert found["depth_share"] == pytest.approx((0.25 + 0) / 2)


def test_a_depth_that_is_not_finite_names_the_view():
    with pytest.raises(DataError, match=f"{scene().views[0].name}: depth: nan at row 0"):
        geometry_metrics(scene(), Shows(math.nan))


def test_every_view_is_rendered_once():
    rendered = []

    class Counts(Shows):
        def render(self, view: View, background=None) -> RenderOutput:
            rendered.append(view)
            return super().render(view, background)

    geometry_metrics(scene(), Counts(4.0))
    assert len(rendered) == 3


def test_a_scene_without_truth_has_no_such_metrics():
    assert geometry_metrics(tiny_scene(), Shows(4.0)) == {}
