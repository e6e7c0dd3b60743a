"""The paper's seam metrics against scalar loops, hand-worked numbers and their invariants."""

import dataclasses
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.images import noise_image
from helpers.tiny_scene import camera, random_gaussians
from splatproof.base.errors import DataError, UsageError
from splatproof.metrics.pixel import psnr
from splatproof.metrics.seam import (
    SeamSums,
    SeamView,
    depth_gradient,
    leading_blocks,
    overlap_band,
    seam_mask,
    seam_scores,
    seam_sums,
)
from splatproof.metrics.seam_render import render_seam_view
from splatproof.reference.rasterizer.rasterize import rasterize


def random_view(height: int, width: int, count: int, seed: int, share: float = 0.5) -> SeamView:
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int):
        return torch.rand(*shape, generator=generator)

    return SeamView(
        image=uniform(height, width, 3),
        truth=uniform(height, width, 3),
        depth=1 + uniform(height, width),
        seam=uniform(height, width) < share,
        block_weights=uniform(height, width, count),
        block_images=uniform(count, height, width, 3),
        block_depths=1 + uniform(count, height, width),
    )


VIEWS = st.builds(
    random_view,
    st.integers(1, 7),
    st.integers(1, 7),
    st.integers(1, 4),
    st.integers(0, 2**16),
    st.sampled_from([0.0, 0.3, 1.0]),
)


def slope(depth, i, j):
    """(dD/dx, dD/dy) at one pixel from its neighbours, by hand."""
    height, width = depth.shape

    def along(get, at, size):
        if size == 1:
            return 0.0
        low, high = max(at - 1, 0), min(at + 1, size - 1)
        return (get(high) - get(low)) / (high - low)

    return (
        along(lambda x: float(depth[i, x]), j, width),
        along(lambda y: float(depth[y, j]), i, height),
    )


def slow_scores(views):
    """The paper's formulas pixel by pixel."""
    squared = difference = jump = gradient = 0.0
    count = total = 0
    for view in views:
        for i in range(view.seam.shape[0]):
            for j in range(view.seam.shape[1]):
                total += 1
                if not view.seam[i, j]:
                    continue
                count += 1
                ranked = sorted(
                    enumerate(view.block_weights[i, j].tolist()), key=lambda kv: (-kv[1], kv[0])
                )
                a = ranked[0][0]
                b = ranked[1][0] if len(ranked) > 1 and ranked[1][1] > 0 else a
                for c in range(3):
                    squared += (float(view.image[i, j, c]) - float(view.truth[i, j, c])) ** 2
                    difference += abs(
                        float(view.block_images[a, i, j, c]) - float(view.block_images[b, i, j, c])
                    )
                slopes = (slope(view.block_depths[k].double(), i, j) for k in (a, b))
                jump += sum(abs(p - q) for p, q in zip(*slopes, strict=True))
                gradient += sum(abs(g) for g in slope(view.depth.double(), i, j))
    if not count:
        return None
    return {
        "seam_psnr": -10 * math.log10(squared / count / 3),
        "seam_psnr_sum": 10 * math.log10(1 / (squared / count)),
        "bpd_l1": difference / count / 3,
        "bpd_l1_sum": difference / count,
        "nbgj": (jump / count) / (gradient / count + 1e-6),
        "seam_coverage": count / total,
    }


@settings(max_examples=40)
@given(st.lists(VIEWS, min_size=1, max_size=3))
def test_agrees_with_the_formulas_pixel_by_pixel(views):
    want = slow_scores(views)
    got = seam_scores(seam_sums(view) for view in views)
    if want is None:
        assert all(math.isnan(got.values[name]) == (name != "seam_coverage") for name in got.values)
    else:
        assert got.values == pytest.approx(want, rel=1e-9)
        assert not got.undefined


def test_worked_by_hand():
    """Two pixels, one of them seam; error (0.1, 0.2, 0.2), blocks (0.3, 0, 0) apart."""
    truth = torch.zeros(1, 2, 3)
    image = torch.tensor([[[0.1, 0.2, 0.2], [0.9, 0.9, 0.9]]])
    blocks = torch.zeros(2, 1, 2, 3)
    blocks[0, 0, 0, 0] = 0.3
    view = SeamView(
        image=image,
        truth=truth,
        depth=torch.tensor([[1.0, 3.0]]),  # slope 2
        seam=torch.tensor([[True, False]]),
        block_weights=torch.tensor([[[0.6, 0.4], [0.5, 0.5]]]),
        block_images=blocks,
        block_depths=torch.tensor([[[1.0, 2.0]], [[5.0, 4.5]]]),  # slopes 1 and -0.5
    )
    assert seam_scores([seam_sums(view)]).values == pytest.approx(
        {
            "seam_psnr": 10 * math.log10(3 / 0.09),
            "seam_psnr_sum": 10 * math.log10(1 / 0.09),
            "bpd_l1": 0.1,
            "bpd_l1_sum": 0.3,
            "nbgj": 1.5 / (2 + 1e-6),
            "seam_coverage": 0.5,
        },
        rel=1e-6,
    )


@given(VIEWS)
def test_equal_images_and_blocks_are_perfect(view):
    same = dataclasses.replace(
        view,
        truth=view.image,
        seam=torch.ones_like(view.seam),
        block_images=view.image.expand(*view.block_images.shape),
        block_depths=view.depth.expand(*view.block_depths.shape),
    )
    values = seam_scores([seam_sums(same)]).values
    assert values["seam_psnr"] == values["seam_psnr_sum"] == math.inf
    assert values["bpd_l1"] == values["bpd_l1_sum"] == values["nbgj"] == 0
    assert values["seam_coverage"] == 1


@given(VIEWS, st.randoms(use_true_random=False))
def test_swapping_block_names_changes_nothing(view, random):
    order = list(range(view.block_images.shape[0]))
    random.shuffle(order)
    renamed = dataclasses.replace(
        view,
        block_weights=view.block_weights[..., order],
        block_images=view.block_images[order],
        block_depths=view.block_depths[order],
    )
    assert dataclasses.astuple(seam_sums(renamed)) == pytest.approx(
        dataclasses.astuple(seam_sums(view)), rel=1e-12
    )


@given(VIEWS)
def test_pixels_outside_the_seam_cannot_matter(view):
    off = ~view.seam
    image, truth, blocks = view.image.clone(), view.truth.clone(), view.block_images.clone()
    image[off], truth[off], blocks[:, off] = math.nan, 7.0, math.inf
    weights = view.block_weights.clone()
    weights[off] = weights[off].flip(-1)
    other = dataclasses.replace(
        view, image=image, truth=truth, block_images=blocks, block_weights=weights
    )
    assert seam_sums(other) == seam_sums(view)


def test_depths_matter_on_the_seam_and_beside_it_only():
    view = random_view(9, 9, 2, 0)
    seam = torch.zeros(9, 9, dtype=torch.bool)
    seam[4, 4] = True
    view = dataclasses.replace(view, seam=seam)
    far = torch.ones(9, 9, dtype=torch.bool)
    far[3:6, 3:6] = False
    depths, depth = view.block_depths.clone(), view.depth.clone()
    depths[:, far] += 100
    depth[far] += 100
    other = dataclasses.replace(view, block_depths=depths, depth=depth)
    assert seam_sums(other) == seam_sums(view)
    depths[:, 4, 5] *= torch.tensor([1.0, 2.0])
    assert seam_sums(dataclasses.replace(view, block_depths=depths)) != seam_sums(view)


@given(VIEWS, st.floats(0.1, 10))
def test_the_jump_is_relative_to_the_scenes_scale(view, scale):
    """Off by the 1e-6 beside a mean gradient of about 0.3."""
    values = seam_scores([seam_sums(view)]).values
    larger = dataclasses.replace(
        view, depth=view.depth * scale, block_depths=view.block_depths * scale
    )
    after = seam_scores([seam_sums(larger)]).values
    if values["nbgj"] > 0:
        assert after["nbgj"] == pytest.approx(values["nbgj"], rel=1e-3)


def test_the_paper_pools_the_views():
    """A view with few seam pixels weighs little: not the mean of the views' values."""
    small, large = random_view(5, 5, 2, 0, share=0.1), random_view(20, 20, 2, 1, share=0.9)
    small = dataclasses.replace(small, truth=small.image)
    apart = [seam_scores([seam_sums(view)]).values for view in (small, large)]
    pooled = seam_scores(seam_sums(view) for view in (small, large)).values
    assert apart[0]["seam_psnr"] == math.inf
    assert pooled["seam_psnr"] == pytest.approx(apart[1]["seam_psnr"], abs=0.1)
    assert seam_sums(small) + seam_sums(large) == sum(map(seam_sums, (small, large)), SeamSums())


def test_the_two_readings_are_a_factor_of_three_apart():
    values = seam_scores([seam_sums(random_view(6, 6, 3, 0))]).values
    assert values["seam_psnr"] - values["seam_psnr_sum"] == pytest.approx(10 * math.log10(3))
    assert values["bpd_l1_sum"] == pytest.approx(3 * values["bpd_l1"])


def test_an_empty_seam_is_undefined_with_a_reason():
    got = seam_scores([seam_sums(random_view(4, 5, 2, 0, share=0.0))])
    assert got.values["seam_coverage"] == 0
    assert {name for name, value in got.values.items() if math.isnan(value)} == set(got.undefined)
    assert set(got.undefined.values()) == {"the seam mask is empty in all 20 pixels"}
    nothing = seam_scores([])
    assert nothing.undefined["seam_coverage"] == "no view was given"
    assert math.isnan(nothing.values["seam_coverage"])


@pytest.mark.parametrize("field", ["image", "truth", "block_images"])
def test_colours_outside_the_range_on_the_seam_are_refused(field):
    view = random_view(4, 5, 2, 0, share=1.0)
    with pytest.raises(DataError, match=r"in R at row 0, column 0 .* expected values in \[0, 1\]"):
        seam_sums(dataclasses.replace(view, **{field: 1.5 + getattr(view, field)}))


@pytest.mark.parametrize("field", ["depth", "block_depths"])
def test_depths_that_are_not_finite_are_refused(field):
    view = random_view(4, 5, 2, 0)
    with pytest.raises(DataError, match="not finite"):
        seam_sums(dataclasses.replace(view, **{field: getattr(view, field) * math.inf}))


def test_the_band_is_open_below_and_closed_above():
    distances = torch.tensor([0.0, 1.0, 1.0000001, 1.05, 1.1, 1.1000001, 2.0], dtype=torch.float64)
    assert overlap_band(distances).tolist() == [False, False, True, True, True, False, False]


def test_the_mask_takes_the_two_strongest_contributors():
    band = torch.tensor([False, True, False, False])
    blocks = torch.tensor([0, 0, 1, 1])
    ids = torch.tensor([[[1, 0, 2], [0, 1, 2], [0, 2, 1], [-1, -1, -1], [1, -1, -1], [3, -1, 1]]])
    want = [[True, True, False, False, True, False]]
    assert seam_mask(ids, band, blocks).tolist() == want
    # -1 must read neither the first primitive nor the last
    nothing = torch.full((1, 1, 2), -1)
    assert not seam_mask(nothing, torch.tensor([False, True]), blocks[1:3]).any()
    assert not seam_mask(nothing, torch.tensor([True, False]), blocks[1:3]).any()
    with pytest.raises(UsageError, match="render with contributors=2"):
        seam_mask(ids[..., :1], band, blocks)


def test_one_block_has_no_seam():
    ids, band = torch.zeros(3, 3, 2, dtype=torch.int64), torch.tensor([True])
    assert not seam_mask(ids, band, torch.tensor([4])).any()
    assert seam_mask(ids, torch.tensor([True, False]), torch.tensor([4, 2])).all()


def test_leading_blocks_by_hand():
    weights = torch.tensor([[[0.1, 0.5, 0.4], [0.0, 0.0, 0.2], [0.0, 0.0, 0.0], [0.3, 0.3, 0.3]]])
    assert leading_blocks(weights).tolist() == [[[1, 2], [2, 2], [0, 0], [0, 1]]]
    assert leading_blocks(weights[..., :1]).tolist() == [[[0, 0]] * 4]


def test_the_gradient_of_a_ramp():
    rows, columns = torch.meshgrid(torch.arange(5.0), torch.arange(4.0), indexing="ij")
    got = depth_gradient((3 * columns - 2 * rows + 1)[None])
    assert torch.equal(got[0], torch.tensor([3.0, -2.0]).expand(5, 4, 2))
    assert torch.equal(depth_gradient(torch.ones(1, 1, 1)), torch.zeros(1, 1, 1, 2))


def two_halves(count: int = 60):
    """Gaussians split at x = 0 into two blocks; distances to boxes of half-extent 1 about x = +-1."""
    model = random_gaussians(count, seed=3)
    blocks = (model.means[:, 0] > 0).long()
    distances = 1 + 0.2 * (0.4 - model.means[:, 0].abs())  # the rim lies at x = 0
    return model, blocks, distances.double()


def test_a_rendered_view_has_its_seam_between_the_blocks():
    model, blocks, distances = two_halves()
    where = camera(2, width=32, height=24)
    truth = noise_image(24, 32, 0)
    view = render_seam_view(rasterize, where, model, blocks, distances, truth)
    whole = rasterize(
        where, model.means, model.quaternions, model.scales, model.opacities,
        sh=model.sh, contributors=len(model),
    )  # fmt: skip
    assert view.block_weights.sum(dim=2) == pytest.approx(whole.alpha, abs=1e-6)
    assert whole.contributor_ids is not None
    band = overlap_band(distances)
    for i, j in ((0, 0), (12, 16), (8, 20), (20, 5)):
        top = [k for k in whole.contributor_ids[i, j, :2].tolist() if k >= 0]
        assert bool(view.seam[i, j]) == any(bool(band[k]) for k in top)
    columns = view.seam.nonzero()[:, 1].double()
    assert 0 < view.seam.double().mean() < 1
    assert 10 < columns.mean() < 22
    values = seam_scores([seam_sums(view)]).values
    assert values["seam_psnr"] == pytest.approx(psnr(view.image, truth, view.seam))
    assert values["bpd_l1"] > 0


def test_each_block_is_rendered_alone():
    """Three blocks: with two, a block and all others but it would be one and the same pair."""
    model, _, distances = two_halves()
    blocks, where = torch.arange(len(model)) % 3, camera(1)
    grey = torch.full((3,), 0.5)
    view = render_seam_view(
        rasterize, where, model, blocks, distances, noise_image(18, 24, 0), background=grey
    )
    for block in range(3):
        mine = blocks == block
        want = rasterize(
            where, model.means[mine], model.quaternions[mine], model.scales[mine],
            model.opacities[mine], sh=model.sh[mine], background=grey,
        )  # fmt: skip
        assert torch.equal(view.block_images[block], want.colour.clamp(0, 1))
        assert torch.equal(view.block_depths[block], want.depth)


def test_swapped_names_and_a_single_block_when_rendered():
    model, blocks, distances = two_halves()
    where, truth = camera(2), noise_image(18, 24, 0)
    first = render_seam_view(rasterize, where, model, blocks, distances, truth)
    second = render_seam_view(rasterize, where, model, 1 - blocks, distances, truth)
    assert dataclasses.astuple(seam_sums(first)) == pytest.approx(
        dataclasses.astuple(seam_sums(second)), rel=1e-6
    )
    alone = render_seam_view(rasterize, where, model, 0 * blocks, distances, truth)
    assert not alone.seam.any()
