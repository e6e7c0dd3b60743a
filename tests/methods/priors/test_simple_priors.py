"""The oracle, the oracle with noise, and LiDAR that is completed."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from helpers.prior_scenes import plane_depth, plane_scene, sweep_of
from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.priors import lidar, noisy, oracle
from splatproof.reference.types.scene import DepthPrior, Sweep


def test_the_oracle_is_one_over_depth():
    depth = torch.tensor([[2.0, torch.inf], [0.0, torch.nan]])
    prior = oracle.prior_of(depth)
    assert_close(prior.disparity, torch.tensor([[0.5, 0.0], [0.0, 0.0]]))
    assert prior.valid.tolist() == [[True, True], [False, False]]


@pytest.mark.parametrize("prepare", [oracle.prepare, noisy.prepare])
def test_oracles_want_truth(prepare):
    with pytest.raises(UsageError, match="tiny: 5 of 5 training views have no true depth") as error:
        prepare(tiny_scene(), None, 0)
    assert "'sweep' does without" in str(error.value)


def wall() -> DepthPrior:
    return oracle.prior_of(plane_depth(camera(0, width=120, height=90)))


def drawn(seed: int) -> DepthPrior:
    return noisy.disturbed(wall(), np.random.Generator(np.random.PCG64(seed)))


def test_noise_keeps_the_order_of_depths_and_is_off_by_about_a_tenth():
    """After the best scale and zero; what it is on the worlds stands in `noisy.disturbed`."""
    truth = wall()
    solid = truth.disparity > 0
    t = truth.disparity[solid].double()
    off = []
    for seed in range(20):
        prior = drawn(seed)
        assert torch.equal(prior.valid, truth.valid)
        p = prior.disparity[solid].double()
        ranks = torch.stack([p.argsort().argsort(), t.argsort().argsort()]).double()
        assert float(torch.corrcoef(ranks)[0, 1]) > 0.8  # Spearman's
        fit = torch.linalg.lstsq(torch.stack([p, torch.ones_like(p)], dim=1), t).solution
        off.append(float(((fit[0] * p + fit[1] - t).abs() / t).mean()))
    assert 0.04 < np.mean(off) < 0.2
    assert np.std(off) > 0.005  # views differ


def test_noise_is_the_seeds_and_the_views():
    scene = plane_scene()
    first, again = (noisy.prepare(scene, None, 3)(1) for _ in range(2))
    assert torch.equal(first.disparity, again.disparity)
    assert not torch.equal(first.disparity, noisy.prepare(scene, None, 4)(1).disparity)
    views = list(scene.views)
    views[2] = replace(views[2], load_depth=scene.views[1].load_depth)
    other = noisy.prepare(replace(scene, views=tuple(views)), None, 3)(2)
    assert not torch.equal(first.disparity, other.disparity)


def test_a_plane_is_completed_exactly():
    """It is linear in disparity over the image, so that no other interpolation would do."""
    where = camera(2, width=60, height=40)
    depth = plane_depth(where)
    prior = lidar.completed(where, sweep_of(where, depth, step=4))
    assert_close(prior.disparity[prior.valid], 1 / depth[prior.valid], rtol=1e-4, atol=0)
    assert prior.valid[5:-5, 2:-5].all()  # between the hits
    assert not prior.valid[:2].any()
    assert not prior.valid[-1].any()
    assert (prior.disparity[~prior.valid] == 0).all()


def test_hits_behind_a_nearer_surface_are_hidden_and_edges_are_not_filled():
    where = camera(2, width=60, height=40)
    wall, box = torch.full((40, 60), 8.0), torch.full((40, 60), torch.inf)
    box[10:30, 20:40] = 3.0
    hits = [sweep_of(where, depth, step=2).positions for depth in (wall, box)]
    prior = lidar.completed(where, Sweep(positions=torch.cat(hits), origin=where.centre))
    depth = 1 / prior.disparity
    assert_close(depth[12:28, 22:38], torch.full((16, 16), 3.0))
    off = prior.valid & ((depth - 3).abs() > 0.01) & ((depth - 8).abs() > 0.01)
    assert not off.any()
    assert_close(depth[prior.valid][:20], torch.full((20,), 8.0))


def test_gaps_are_not_filled():
    where = camera(2, width=60, height=40)
    wall = torch.full((40, 60), 8.0)
    wall[:, 25:45] = torch.inf
    prior = lidar.completed(where, sweep_of(where, wall, step=2))
    assert not prior.valid[:, 26:44].any()
    assert prior.valid[2:-3, 2:23].all()


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_hits_that_span_nothing_say_nothing(count):
    where = camera(2)
    behind = where.centre - 3 * where.rotation[2]
    line = (
        where.centre
        + 3 * where.rotation[2]
        + 0.2 * torch.arange(count)[:, None] * where.rotation[0]
    )
    for positions in (behind[None].expand(count, 3), line):
        prior = lidar.completed(where, Sweep(positions=positions.float(), origin=where.centre))
        assert not prior.valid.any()
        assert (prior.disparity == 0).all()


def test_lidar_wants_a_sweep_and_does_with_one():
    with pytest.raises(
        UsageError, match="tiny: no training view has a LiDAR sweep.*'sweep' is made"
    ):
        lidar.prepare(plane_scene(sweep=False), None, 0)
    scene = plane_scene()
    views = list(scene.views)
    views[1] = replace(views[1], load_sweep=None)
    make = lidar.prepare(replace(scene, views=tuple(views)), None, 0)
    assert not make(1).valid.any()
    assert make(2).valid.any()
