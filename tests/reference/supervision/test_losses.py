"""The training loss against a slow direct formula, gradcheck and its invariants."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import correlate1d

from splatproof.reference.supervision import losses


def pair(height: int, width: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    a, b = torch.rand(2, height, width, 3, generator=generator, dtype=torch.float64)
    return a, b


def direct_ssim(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """SSIM map of one channel by scipy's correlation with zeros outside."""
    x = np.arange(11) - 5
    weight = np.exp(-(x**2) / (2 * 1.5**2))
    weight /= weight.sum()

    def blur(image):
        for axis in (0, 1):
            image = correlate1d(image, weight, axis=axis, mode="constant")
        return image

    ma, mb = blur(a), blur(b)
    va, vb, ab = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    top = (2 * ma * mb + 1e-4) * (2 * ab + 9e-4)
    return top / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))


@given(height=st.integers(1, 20), width=st.integers(1, 20), seed=st.integers(0, 99))
def test_loss_is_the_direct_formula(height, width, seed):
    a, b = pair(height, width, seed)
    ssim = np.mean([direct_ssim(a[..., c].numpy(), b[..., c].numpy()) for c in range(3)])
    want = 0.8 * float((a - b).abs().mean()) + 0.2 * (1 - ssim)
    assert float(losses.photometric(a, b)) == pytest.approx(want, rel=1e-12)


def test_gradient():
    a, b = pair(5, 7, 0)
    mask = torch.rand(5, 7, generator=torch.Generator().manual_seed(1)) > 0.3
    a.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: losses.photometric(x, b), a)
    assert torch.autograd.gradcheck(lambda x: losses.photometric(x, b, mask=mask), a)


def test_equal_images_cost_nothing():
    a, _ = pair(13, 12, 0)
    assert float(losses.photometric(a, a)) == pytest.approx(0, abs=1e-12)
    assert float(losses.photometric(0 * a, 0 * a)) == pytest.approx(0, abs=1e-12)


def test_full_mask_is_no_mask_and_an_empty_one_costs_nothing():
    a, b = pair(13, 12, 0)
    full = torch.ones(13, 12, dtype=torch.bool)
    torch.testing.assert_close(losses.photometric(a, b, mask=full), losses.photometric(a, b))
    assert losses.photometric(a, b, mask=~full) == 0


def test_masked_pixels_change_nothing_and_valid_ones_do():
    a, b = pair(13, 12, 0)
    mask = torch.ones(13, 12, dtype=torch.bool)
    mask[4:9, :5] = False
    before = losses.photometric(a, b, mask=mask)
    a[6, 2], b[5, 1] = 9.0, torch.nan
    assert losses.photometric(a, b, mask=mask) == before
    a[0, 0] = 9.0
    assert losses.photometric(a, b, mask=mask) != before
