"""Completed depths: what priors and memory add, what the settings do, and what nothing can complete."""

from dataclasses import replace
from functools import cache

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.aerial_scene import (
    FLOOR,
    ROOF,
    SIDE,
    aerial_scene,
    camera,
    depth_of,
    prior_of,
    without_points,
)
from splatproof.base.errors import DataError
from splatproof.methods.stratosplat import completion
from splatproof.methods.stratosplat.completion import DenseCloud, completed
from splatproof.methods.stratosplat.prior_depth import (
    FEWEST_POINTS,
    LEAST_RATE,
    believed,
    relative_depth,
)
from splatproof.methods.stratosplat.settings import Completion
from splatproof.reference.layered_memory import guide_depth
from splatproof.reference.layered_memory.depth_adaptation import AdaptationSettings, SparseDepths
from splatproof.reference.types.scene import DepthPrior, Scene


def cloud(scene: Scene, *, guided: bool = True, told: list[str] | None = None, **more):
    return completed(
        scene, Completion(**more), guided=guided, generator=torch.Generator().manual_seed(0),
        report=(told if told is not None else []).append,
    )  # fmt: skip


def error(found) -> float:
    """Mean distance to the floor or the roof, whichever lies under a point."""
    x, y, z = found.positions.unbind(dim=1)
    roof = (x.abs() <= SIDE) & (y.abs() <= SIDE)
    return float((z - torch.where(roof, ROOF, FLOOR)).abs().mean())


def sparse(count: int, seed: int) -> SparseDepths:
    draw = torch.Generator().manual_seed(seed)
    truth = depth_of(camera(1))
    at = torch.randperm(truth.numel(), generator=draw)[:count]
    rows, columns = at // truth.shape[1], at % truth.shape[1]
    return SparseDepths(rows=rows, columns=columns, depths=truth[rows, columns])


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(0.1, 10), zero=st.floats(-2, 2), seed=st.integers(0, 2**16))
def test_scale_and_zero_of_a_prior_do_not_matter(scale, zero, seed):
    """They are found from the points, here 60 of 432 pixels, which see both depths."""
    plain = prior_of(camera(1))
    other = replace(plain, disparity=scale * plain.disparity + zero)
    known = sparse(60, seed)
    want, got = (relative_depth(p, known, (18, 24)) for p in (plain, other))
    assert want is not None
    assert got is not None
    assert torch.allclose(want, got, atol=1e-3)
    near, far = want[depth_of(camera(1)) == ROOF], want[depth_of(camera(1)) == FLOOR]
    assert float(near.max()) < float(far.min())


def test_a_prior_without_points_is_taken_by_its_order():
    none = SparseDepths(
        rows=torch.zeros(0).long(), columns=torch.zeros(0).long(), depths=torch.zeros(0)
    )
    found = relative_depth(prior_of(camera(1)), none, (18, 24))
    assert found is not None
    truth = depth_of(camera(1))
    assert float(found[truth == ROOF].max()) < float(found[truth == FLOOR].min())


def test_pixels_of_which_a_prior_says_nothing_get_what_lies_around():
    plain = prior_of(camera(1))
    valid = plain.valid.clone()
    valid[:4] = False
    wild = plain.disparity.clone()
    wild[:4] = torch.nan
    found = relative_depth(DepthPrior(disparity=wild, valid=valid), sparse(60, 1), (18, 24))
    want = relative_depth(plain, sparse(60, 1), (18, 24))
    assert found is not None
    assert want is not None
    assert torch.allclose(found[5:], want[5:], atol=1e-6)
    assert bool(((found > 0) & (found < 1)).all())
    silent = DepthPrior(disparity=wild, valid=torch.zeros_like(valid))
    assert relative_depth(silent, sparse(60, 1), (18, 24)) is None


def test_a_larger_prior_is_made_smaller():
    large = prior_of(camera(1, width=48, height=36))
    found = relative_depth(large, sparse(60, 1), (18, 24))
    assert found is not None
    assert found.shape == (18, 24)


def test_a_true_prior_completes_what_few_points_do_not_show():
    """Six points, none of them needed on the roof: without a prior its edges alone speak for it."""
    with_prior, without = (error(cloud(aerial_scene(points=6, prior=p))) for p in (True, False))
    assert with_prior < 0.05
    assert with_prior < 0.6 * without  # 0.037 and 0.072 were seen


def test_the_memory_merges_what_views_share():
    layered = cloud(aerial_scene(prior=True), merge=0.02, guidance_steps=5)
    kept = cloud(aerial_scene(prior=True), memory="accumulate", guidance_steps=5)
    # a sparse point may be where a pixel's sample is
    assert 3 * 24 * 18 <= len(kept.positions) <= 3 * 24 * 18 + 30
    assert len(layered.positions) < 0.7 * len(kept.positions)


@pytest.mark.parametrize("order", ["random", "distance", "coverage"])
def test_views_come_in_the_order_asked_for(order, monkeypatch):
    scene = without_points(aerial_scene(), view=1)  # so that 1 has the fewest
    seen = []
    real = completion.adapt_view

    def watched(denoiser, image, *rest):
        seen.append(float(image.double().sum()))
        return real(denoiser, image, *rest)

    monkeypatch.setattr(completion, "adapt_view", watched)
    cloud(scene, order=order, guidance_steps=1)
    sums = [float(scene.views[i].load().double().sum()) for i in (1, 2, 3)]
    assert sorted(seen) == sorted(sums)
    if order == "coverage":
        assert seen[-1] == sums[0]
    if order == "distance":
        assert seen[0] == sums[1]  # the middle of the row


def test_independent_views_do_not_see_the_memory(monkeypatch):
    monkeypatch.setattr(
        completion.guide_depth, "render", lambda *_: pytest.fail("the memory was asked")
    )
    cloud(aerial_scene(), guided=False, guidance_steps=1)


def test_the_memory_guides_as_the_reference_draws_it(monkeypatch):
    """A float32 that is off by one on the way to the denoiser is all that may differ."""
    asked = {"guidance_steps": 1, "visible_weight": 10.0}
    found = cloud(aerial_scene(), **asked)
    monkeypatch.setattr(completion.guide_depth, "render", guide_depth.render)
    assert_close(found.positions, cloud(aerial_scene(), **asked).positions, atol=1e-4, rtol=0)


def test_a_view_without_points_is_guided_by_the_others():
    found = cloud(without_points(aerial_scene(prior=True), view=2))
    assert error(found) < 0.1


def test_a_view_without_points_or_memory_is_left_out_by_name():
    told: list[str] = []
    asked = {"guided": False, "guidance_steps": 1, "memory": "accumulate"}
    alone = cloud(without_points(aerial_scene(), view=2), told=told, **asked)
    (line,) = told
    assert "they show no point, and init = 'independent' completes" in line
    assert "by its own points alone: 2.png; init = 'layered' would use" in line
    assert "overlap" not in line
    assert len(alone.positions) < 0.8 * len(cloud(aerial_scene(), **asked).positions)


def test_a_view_that_no_memory_reaches_is_left_out_by_name(monkeypatch):
    monkeypatch.setattr(
        completion.guide_depth, "render",
        lambda memory, camera: (torch.zeros(camera.height, camera.width).double(), torch.zeros(camera.height, camera.width) > 0),
    )  # fmt: skip
    told: list[str] = []
    cloud(without_points(aerial_scene(), view=2), told=told, guidance_steps=1)
    assert "they show no point and overlap no completed view" in told[0]
    assert "is: 2.png; --points triangulated" in told[0]


@pytest.mark.parametrize("order", ["coverage", "distance", "random"])
def test_a_view_without_points_waits_for_one_that_reaches_it(monkeypatch, order):
    """Without sparse points in the memory nothing guides the first view that shows none."""
    real = completion.guide_depth.render
    asked: list[str] = []

    def late(memory, seen_from):
        asked.append(str(seen_from.centre.tolist()))
        depth, visible = real(memory, seen_from)
        return depth, visible & (len(asked) > 3)

    monkeypatch.setattr(completion.guide_depth, "render", late)
    told: list[str] = []
    cloud(without_points(aerial_scene(), view=2), order=order, guidance_steps=1, told=told)
    assert len(asked) == 4  # three views once, the one without points again
    assert asked.count(asked[-1]) == 2
    assert not any("left out" in line for line in told)


def test_no_view_with_points_is_refused():
    scene = aerial_scene()
    far = replace(scene, points=replace(scene.points, positions=scene.points.positions + 1e3))
    with pytest.raises(DataError, match="no training view shows a sparse point"):
        cloud(far)


def test_samples_beyond_the_memory_are_told():
    """Points on the roof alone: the floor lies beyond the frusta that they end."""
    told: list[str] = []
    scene = aerial_scene(prior=True, points=300)
    high = scene.points.positions[:, 2] < 3.5
    assert 5 < int(high.sum()) < 100
    shown = replace(
        scene,
        points=replace(
            scene.points, positions=scene.points.positions[high], colours=scene.points.colours[high],
            track_starts=torch.zeros(int(high.sum()) + 1, dtype=torch.int64),
            track_views=torch.zeros(0, dtype=torch.int64),
        ),
    )  # fmt: skip
    found = cloud(shown, told=told, guidance_steps=2)
    assert bool(told) == bool(found.unseen or found.forced)


def test_large_photos_are_completed_small():
    few = {"memory": "accumulate", "guidance_steps": 1}
    full, small = (cloud(aerial_scene(), side=s, **few) for s in (24, 12))
    assert 3 * 24 * 18 <= len(full.positions) <= 3 * 24 * 18 + 30
    assert 3 * 12 * 9 <= len(small.positions) <= 3 * 12 * 9 + 30


@pytest.mark.parametrize("times", [100.0, 0.05])
def test_one_wrong_point_changes_neither_the_memory_nor_the_result(monkeypatch, times):
    """A point a hundred times as far as all others made a memory of gigabytes, and spoilt every depth."""
    starts, told = [], list[str]()
    real = completion.layered_depth.empty
    monkeypatch.setattr(
        completion.layered_depth, "empty",
        lambda where, *rest: starts.append((where.width, where.height, *rest)) or real(where, *rest),
    )  # fmt: skip
    scene = aerial_scene()
    more = with_one_more(scene, times)
    want, found = (cloud(one, guidance_steps=1, told=told) for one in (scene, more))
    assert starts[0] == starts[1]
    assert torch.equal(found.positions[:-1], want.positions)
    assert torch.equal(found.positions[-1], more.points.positions[-1])
    assert told == ["completion: 1 points lie far beyond all others and guide no depth"]


def with_one_more(scene: Scene, times: float) -> Scene:
    """The scene with one more point, on the axis of view 1, in its track alone."""
    points, lens = scene.points, scene.views[1].camera
    place = lens.centre + times * FLOOR * lens.rotation[2]
    return replace(
        scene,
        points=replace(
            points,
            positions=torch.cat([points.positions, place[None]]),
            colours=torch.cat([points.colours, points.colours[:1]]),
            track_starts=torch.cat([points.track_starts, points.track_starts[-1:] + 1]),
            track_views=torch.cat([points.track_views, torch.tensor([1])]),
        ),
    )


@given(
    few=st.lists(st.floats(1.0, 3.9), min_size=3, max_size=300),
    wrong=st.sampled_from([1e-3, 1e3]),
)
def test_a_depth_far_beyond_the_others_is_wrong_and_no_other(few, wrong):
    depths = torch.tensor([*few, wrong]).double()
    assert completion.plausible(depths).tolist() == [*[True] * len(few), False]
    assert completion.plausible(depths[:-1]).all()
    assert completion.plausible(depths[-2:]).all()


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(0.1, 10), zero=st.floats(-2, 2), seed=st.integers(0, 2**16))
def test_a_prior_that_the_points_bear_out_is_kept_and_guided_in_short_steps(scale, zero, seed):
    plain, known, asked = prior_of(camera(1)), sparse(60, seed), AdaptationSettings()
    said = relative_depth(replace(plain, disparity=scale * plain.disparity + zero), known, (18, 24))
    assert said is not None
    prior, steps = believed(said, known, unit=1.0, settings=asked)
    assert prior is said
    assert steps.learning_rate < 0.1 * asked.learning_rate
    assert replace(steps, learning_rate=asked.learning_rate) == asked


def test_steps_grow_with_the_error_of_a_prior_until_it_is_left_out():
    known, asked = sparse(60, 1), AdaptationSettings()
    truth = relative_depth(prior_of(camera(1)), known, (18, 24))
    assert truth is not None
    noise = torch.randn(18, 24, generator=torch.Generator().manual_seed(0))
    rates = []
    for off in (0.0, 0.01, 0.02, 0.03):
        said = (truth + off * noise).clamp(0.01, 0.99)
        prior, steps = believed(said, known, unit=1.0, settings=asked)
        assert prior is said
        rates.append(steps.learning_rate)
    assert LEAST_RATE == rates[0] < rates[1] < rates[2] < rates[3] < asked.learning_rate
    for wrong in (1 - truth, noise.abs().clamp(0.1, 0.9)):
        assert believed(wrong, known, unit=1.0, settings=asked) == (None, asked)


def test_a_prior_that_few_points_see_is_kept_as_it_is():
    prior, known, asked = torch.rand(18, 24), sparse(FEWEST_POINTS - 1, 0), AdaptationSettings()
    assert believed(prior, known, unit=1.0, settings=asked) == (prior, asked)


@cache
def plain_cloud() -> DenseCloud:
    """Of many points that are all right, without a prior."""
    return cloud(aerial_scene(points=300))


def test_many_points_leave_a_true_prior_alone_and_wrong_ones_do_not_tear_it():
    """A tenth of the points are half again as far away; they stay in the cloud themselves, with or without a prior."""

    def found(*, prior: bool, wrong: bool) -> float:
        if not prior and not wrong:
            return error(plain_cloud())
        scene = aerial_scene(points=300, prior=prior)
        positions = scene.points.positions.clone()
        positions[::10, 2] += 0.5 * (FLOOR - ROOF) * wrong
        return error(cloud(replace(scene, points=replace(scene.points, positions=positions))))

    # 0.014 and 0.042, 0.047 and 0.075 were seen; 0.030 and 0.060 with a prior where steps are as long as without one
    assert found(prior=True, wrong=False) < 0.5 * found(prior=False, wrong=False)
    assert found(prior=True, wrong=True) < 0.7 * found(prior=False, wrong=True)


def test_a_prior_that_contradicts_the_points_changes_nothing_and_is_told():
    told: list[str] = []
    without = plain_cloud()
    scene = aerial_scene(points=300, prior=True)
    views = tuple(
        replace(view, load_prior=lambda view=view: _inverted(prior_of(view.camera)))
        if view.load_prior is not None
        else view
        for view in scene.views
    )
    found = cloud(replace(scene, views=views), told=told)
    assert torch.equal(found.positions, without.positions)
    assert (
        "the depth priors of 3 of 3 photos contradict what is known there and are left out"
        in told[0]
    )


def _inverted(prior: DepthPrior) -> DepthPrior:
    return replace(prior, disparity=-prior.disparity)


def test_what_a_mask_hides_does_not_enter_the_memory():
    """A hand in front of the lens is nowhere in the scene; what others show behind it is."""
    scene, counted = aerial_scene(prior=True), torch.ones(18, 24, dtype=torch.bool)
    counted[4:14, 6:18] = False
    views = list(scene.views)
    for index in scene.train:
        hand = views[index].load().where(counted[..., None], torch.tensor([0.0, 1.0, 0.0]))
        views[index] = replace(views[index], load=hand.clone, load_mask=counted.clone)
    open_ = replace(scene, views=tuple(replace(view, load_mask=None) for view in views))
    green = torch.tensor([0.0, 1.0, 0.0]).double()
    pure, shown = (
        (found.colours - green).abs().amax(dim=1) < 1e-3
        for found in (cloud(replace(scene, views=tuple(views))), cloud(open_))
    )
    assert shown.any()
    assert not pure.any()


def test_a_pixel_of_a_smaller_photo_counts_where_all_of_it_does():
    scene, counted = aerial_scene(prior=True), torch.ones(18, 24, dtype=torch.bool)
    counted[5, 7] = False
    masked = tuple(replace(view, load_mask=counted.clone) for view in scene.views)
    found = [len(cloud(one, side=12, memory="accumulate").positions)
             for one in (scene, replace(scene, views=masked))]  # fmt: skip
    assert found[0] - found[1] == len(scene.train)
