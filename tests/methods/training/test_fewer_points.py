"""Fewer points: never more than asked, means of what they replace, tracks of all of it."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.tiny_scene import tiny_scene
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare, started
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.fewer_points import with_at_most
from splatproof.reference.types.scene import Scene, SparsePoints


def scene_of(positions: torch.Tensor) -> Scene:
    """Points whose colour is their number and of which point i is seen by view i mod 5 alone."""
    count = len(positions)
    points = SparsePoints(
        positions=positions.double(),
        colours=(torch.arange(count) % 256).to(torch.uint8)[:, None].repeat(1, 3),
        track_starts=torch.arange(count + 1),
        track_views=torch.arange(count) % 5 + 1,
    )
    return replace(tiny_scene(), points=points)


@settings(max_examples=15)
@given(count=st.integers(1, 200), most=st.integers(1, 220), seed=st.integers(0, 10))
def test_never_more_and_the_mean_stays(count, most, seed):
    positions = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)).double()
    scene = scene_of(positions)
    fewer = with_at_most(scene, most).points
    assert 1 <= len(fewer) <= most
    if count <= most:
        assert fewer is scene.points
    low, high = positions.amin(dim=0) - 1e-9, positions.amax(dim=0) + 1e-9
    assert bool(((fewer.positions >= low) & (fewer.positions <= high)).all())
    assert int(fewer.track_starts[-1]) == len(fewer.track_views)
    assert set(fewer.track_views.tolist()) == set(scene.points.track_views.tolist())


def test_close_points_become_one_and_lone_ones_stay():
    near = torch.tensor([[0.0, 0, 0], [0.01, 0, 0], [0, 0.02, 0]])
    lone = torch.tensor([[1.0, 1, 1], [0.9, 0.1, 0.5]])
    fewer = with_at_most(scene_of(torch.cat([near, lone])), 3).points
    assert len(fewer) == 3
    merged = fewer.positions[(fewer.positions.norm(dim=1)).argmin()]
    assert torch.allclose(merged, near.double().mean(dim=0))
    kept = {tuple(row) for row in fewer.positions.float().tolist()}
    assert {tuple(row) for row in lone.tolist()} <= kept
    row = int(fewer.positions.norm(dim=1).argmin())
    seen = fewer.track_views[fewer.track_starts[row] : fewer.track_starts[row + 1]]
    assert seen.tolist() == [1, 2, 3]


def test_a_shifted_scene_has_the_same_points_shifted():
    positions = torch.randn(100, 3, generator=torch.Generator().manual_seed(0)).double()
    shift = torch.tensor([4.0, -8.0, 16.0], dtype=torch.float64)  # exact in binary
    here, there = (with_at_most(scene_of(p), 20).points for p in (positions, positions + shift))
    assert torch.allclose(here.positions + shift, there.positions, atol=1e-9)


def test_all_points_in_one_place():
    assert len(with_at_most(scene_of(torch.ones(50, 3)), 10).points) == 1


@pytest.mark.parametrize(("most", "count"), [(None, 40), (10, 10), (1000, 40)])
def test_training_starts_from_them(most, count):
    settings, run = Settings(iterations=10, most_points=most), Run()
    model, _ = prepare(started(tiny_scene(), settings, run), settings, run)
    assert model.primitives <= count
    assert most == 10 or model.primitives == count
