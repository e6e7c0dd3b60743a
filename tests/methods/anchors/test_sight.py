"""What share of the points views show."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import sparse_points, tiny_scene
from splatproof.methods.anchors.sight import share_in_view


def test_share_by_hand():
    """One point in the middle of the cube, one behind the cameras, one far to the side."""
    scene = tiny_scene()
    places = torch.tensor([[0.0, 0, 0], [0, 0, -50], [60, 0, 0]], dtype=torch.float64)
    assert share_in_view(replace(scene, points=sparse_points(places))) == pytest.approx(1 / 3)
    assert share_in_view(replace(scene, points=sparse_points(places[:0]))) == 1.0


def test_many_points_and_views_are_sampled():
    scene = tiny_scene()
    places = torch.zeros(30_001, 3, dtype=torch.float64)
    places[::3, 2] = -50  # of every 3 points one is behind, and so of those that are looked at
    crowd = replace(scene, train=scene.train * 20, points=sparse_points(places))
    assert share_in_view(crowd) == pytest.approx(2 / 3, abs=1e-3)
