"""The SSIM variants against scikit-image, kornia and a slow direct formula."""

import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from kornia.losses import MS_SSIMLoss
from kornia.metrics import ssim as kornia_ssim
from skimage.metrics import structural_similarity

from helpers.images import noise_image, pairs, photo, random_mask, spoiled
from splatproof.metrics.ssim import (
    SCALES_WINDOW,
    UNIFORM_WINDOW,
    WINDOW,
    ms_ssim_kornia,
    ssim_3dgs,
    ssim_kornia,
    ssim_skimage,
    ssim_valid,
    windows_valid,
)

VARIANTS = {
    ssim_3dgs: WINDOW,
    ssim_valid: WINDOW,
    ssim_skimage: UNIFORM_WINDOW,
    ssim_kornia: WINDOW,
    ms_ssim_kornia: SCALES_WINDOW,
}
ROUNDING = 1e-9
"""Float64 sums of about 121 products of numbers near 1, divided by C2 = 9e-4."""


def slow_ssim(x, y, weights, unbiased=False):
    """SSIM of two patches by its definition: weighted moments, one window, one channel."""
    n = weights.size
    mx, my = (weights * x).sum(), (weights * y).sum()
    more = n / (n - 1) if unbiased else 1.0
    vx, vy = (more * (weights * (a - m) ** 2).sum() for a, m in ((x, mx), (y, my)))
    cov = more * (weights * (x - mx) * (y - my)).sum()
    c1, c2 = 0.01**2, 0.03**2
    return (2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))


def slow_mean(image, target, weights, padding, unbiased=False):
    """Mean of slow_ssim over all windows; `padding` zeros beyond each border."""
    side = len(weights)
    x, y = (np.pad(a.double().numpy(), [(padding,) * 2] * 2 + [(0, 0)]) for a in (image, target))
    values = [
        slow_ssim(
            x[i : i + side, j : j + side, c], y[i : i + side, j : j + side, c], weights, unbiased
        )
        for i in range(x.shape[0] - side + 1)
        for j in range(x.shape[1] - side + 1)
        for c in range(3)
    ]
    return float(np.mean(values))


def gaussian(side: int = 11, sigma: float = 1.5):
    offsets = np.arange(side) - side // 2
    line = np.exp(-(offsets**2) / (2 * sigma**2))
    return np.outer(line, line) / line.sum() ** 2


@settings(max_examples=10)
@given(pairs(smallest=11, largest=16))
def test_agrees_with_the_slow_direct_formula(pair):
    image, target = pair
    for metric, weights, padding, unbiased in (
        (ssim_3dgs, gaussian(), 5, False),
        (ssim_valid, gaussian(), 0, False),
        (ssim_skimage, np.full((7, 7), 1 / 49), 0, True),
    ):
        want = slow_mean(image, target, weights, padding, unbiased)
        assert metric(image, target) == pytest.approx(want, abs=ROUNDING)


@given(pairs(smallest=11))
def test_valid_agrees_with_scikit_image_and_kornia(pair):
    image, target = (x.double() for x in pair)
    skimage = structural_similarity(
        image.numpy(),
        target.numpy(),
        data_range=1,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    first, second = (x.permute(2, 0, 1)[None] for x in (image, target))
    kornia = kornia_ssim(first, second, 11, eps=0.0, padding="valid").mean()
    assert ssim_valid(*pair) == pytest.approx(skimage, abs=ROUNDING)
    assert ssim_valid(*pair) == pytest.approx(float(kornia), abs=ROUNDING)


def mirrored(image):
    """The image with 5 px beyond each border, mirrored at the border pixels' centres."""
    return torch.from_numpy(np.pad(image.numpy(), [(5, 5), (5, 5), (0, 0)], mode="reflect"))


@settings(max_examples=10)
@given(pairs(smallest=11, largest=16))
def test_kornias_agrees_with_the_slow_formula_on_mirrored_images(pair):
    image, target = (mirrored(x) for x in pair)
    assert ssim_kornia(*pair) == pytest.approx(
        slow_mean(image, target, gaussian(), 0), abs=ROUNDING
    )


def test_kornias_is_another_number_than_those_with_other_borders():
    target = noise_image(20, 24, 0)
    image = spoiled(target, 0.1)
    assert abs(ssim_kornia(image, target) - ssim_3dgs(image, target)) > 1e-4
    assert abs(ssim_kornia(image, target) - ssim_valid(image, target)) > 1e-4


@settings(max_examples=10)
@given(pairs(smallest=33, largest=36))
def test_multi_scale_agrees_with_kornia(pair):
    first, second = (x.double().permute(2, 0, 1)[None] for x in pair)
    loss = MS_SSIMLoss(alpha=1.0, compensation=1.0).double()
    # Kornia's windows are built in float32: 33 x 33 weights off by up to 6e-8 of their size.
    assert ms_ssim_kornia(*pair) == pytest.approx(1 - float(loss(first, second)), abs=2e-6)


def formula_pair():
    """Two images from a formula alone, the same on every machine."""
    i, j, c = torch.meshgrid(torch.arange(48), torch.arange(40), torch.arange(3), indexing="ij")
    target = 0.5 + 0.4 * torch.sin(0.9 * i.double() + 0.37 * j + c)
    image = target + 0.08 * torch.cos(1.7 * i.double() - 1.1 * j + 2 * c)
    return image.clamp(0, 1).float(), target.float()


# By slow_mean above (windows one by one, two-pass moments), multi-scale by kornia.
GOLDEN = {
    ssim_3dgs: 0.9796032,
    ssim_valid: 0.9777967,
    ssim_skimage: 0.9804988,
    ssim_kornia: 0.9770032,
    ms_ssim_kornia: 0.8611394,
}


@pytest.mark.parametrize("metric", VARIANTS)
def test_golden_values(metric):
    assert metric(*formula_pair()) == pytest.approx(GOLDEN[metric], abs=2e-6)


def test_variants_differ_on_one_pair_of_photos():
    """One pair, four numbers: why none may stand under another's name."""
    target = photo()
    image = spoiled(target, 0.02, blur=1.5)
    values = sorted(metric(image, target) for metric in (ssim_3dgs, ssim_valid, ssim_skimage))
    assert all(b - a > 2e-3 for a, b in itertools.pairwise(values)), values
    # Old versions of scikit-image guessed the range 2 for floats; ours is fixed at 1.
    guessed = structural_similarity(
        image.numpy(), target.numpy(), data_range=2, channel_axis=-1, full=True
    )[0]
    assert guessed > ssim_skimage(image, target) + 0.05


@pytest.mark.parametrize("metric", VARIANTS)
@settings(max_examples=15)
@given(pairs(smallest=33, largest=40))
def test_properties_that_all_variants_share(metric, pair):
    image, target = pair
    assert metric(target, target) == pytest.approx(1, abs=ROUNDING)
    assert -1 <= metric(image, target) <= 1 + ROUNDING
    assert metric(image, target) == pytest.approx(metric(target, image), abs=ROUNDING)
    for turn in (lambda x: x.flip(0), lambda x: x.transpose(0, 1), lambda x: x[..., [2, 0, 1]]):
        turned = metric(turn(image), turn(target))
        assert turned == pytest.approx(metric(image, target), abs=ROUNDING)
    everything = torch.ones(image.shape[:2], dtype=torch.bool)
    assert metric(image, target, everything) == metric(image, target)


@pytest.mark.parametrize("metric", VARIANTS)
def test_constant_images(metric):
    """No structure: l = (2ab + C1) / (a^2 + b^2 + C1), structure 1 away from the border."""
    flat = torch.full((40, 50, 3), 0.25)
    assert metric(flat, flat) == pytest.approx(1, abs=ROUNDING)
    if metric in (ssim_valid, ssim_skimage):
        want = (2 * 0.25 * 0.5 + 1e-4) / (0.25**2 + 0.5**2 + 1e-4)
        assert metric(flat, 2 * flat) == pytest.approx(want, abs=1e-7)


@pytest.mark.parametrize("metric", VARIANTS)
@settings(max_examples=10)
@given(share=st.floats(0.2, 0.95), seed=st.integers(0, 99))
def test_what_the_mask_hides_cannot_matter(metric, share, seed):
    target = noise_image(60, 70, seed)
    image = spoiled(target, 0.1, seed)
    mask = random_mask(60, 70, share, seed + 1)
    before = metric(image, target, mask)
    image[~mask], target[~mask] = math.nan, 7.0
    after = metric(image, target, mask)
    assert after == before or (math.isnan(after) and math.isnan(before))


@pytest.mark.parametrize("metric", [ssim_3dgs, ssim_valid])
def test_a_mask_means_windows_that_are_fully_valid(metric):
    """A valid rectangle scores as the cropped image does, since only whole windows count."""
    target = noise_image(50, 60, 3)
    image = spoiled(target, 0.1)
    mask = torch.zeros(50, 60, dtype=torch.bool)
    mask[10:40, 15:50] = True
    crop = (slice(10, 40), slice(15, 50))
    assert metric(image, target, mask) == pytest.approx(
        ssim_valid(image[crop], target[crop]), abs=ROUNDING
    )


def test_a_mask_along_the_border_keeps_the_padded_windows():
    """With zero padding a border window is valid as far as it lies inside the image."""
    valid = np.zeros((9, 9), dtype=bool)
    valid[:, :5] = True
    counted = windows_valid(valid, 5, beyond_border=True)
    assert counted[:, :3].all()
    assert not counted[:, 3:].any()
    inside = windows_valid(valid, 5, beyond_border=False)
    assert np.argwhere(inside).tolist() == [[i, 2] for i in range(2, 7)]


@pytest.mark.parametrize("metric", VARIANTS)
def test_no_whole_window_is_nan(metric):
    image = noise_image(40, 40, 0)
    mask = torch.zeros(40, 40, dtype=torch.bool)
    mask[20:23, 20:23] = True
    assert math.isnan(metric(image, 1 - image, mask))


def test_multiplying_by_the_mask_would_inflate():
    """The control: half of the frame blanked in both images and averaged in."""
    target = photo()
    image = spoiled(target, 0.1)
    mask = torch.zeros(400, 600, dtype=torch.bool)
    mask[:, :300] = True
    right = ssim_3dgs(image, target, mask)
    multiplied = ssim_3dgs(image * mask[..., None], target * mask[..., None])
    assert multiplied > right + 0.1


def above(width: int, height: int, seed: int) -> tuple[float, float]:
    """By how much zero padding lifts SSIM of two noisy images, and the bound of docs/words/metrics.toml."""
    generator = torch.Generator().manual_seed(seed)
    truth = torch.rand(height, width, 3, generator=generator)
    image = (truth + 0.2 * torch.randn(height, width, 3, generator=generator)).clamp(0, 1)
    inner = float(ssim_valid(image, truth))
    share = 1 - (1 - 10 / width) * (1 - 10 / height)
    return float(ssim_3dgs(image, truth)) - inner, share * (1 - inner)


@given(width=st.integers(12, 90), height=st.integers(12, 90), seed=st.integers(0, 2**16))
@settings(max_examples=30, deadline=None)
def test_padding_lifts_ssim_by_no_more_than_the_windows_that_it_adds(width, height, seed):
    lifted, bound = above(width, height, seed)
    assert lifted <= bound + 1e-5  # float32 sums over at most 90 x 90 windows


def test_a_thumbnail_shows_more_than_a_hundredth_of_it_and_a_photo_less():
    assert above(64, 48, 0)[0] > 0.01
    assert above(800, 600, 0)[0] < 0.01
