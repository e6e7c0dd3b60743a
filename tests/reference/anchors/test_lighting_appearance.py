"""HVI, the appearance head and its losses."""

import colorsys
import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import structural_similarity
from torch.testing import assert_close

from splatproof.reference.anchors import hvi
from splatproof.reference.anchors import lighting_appearance as la
from splatproof.reference.types import mlp

D = torch.float64
level = st.floats(0, 1)


@given(r=level, g=level, b=level)
def test_hvi_is_the_hexcone_on_a_collapsing_circle(r, g, b):
    h, s, v = colorsys.rgb_to_hsv(r, g, b)
    radius = s * (math.sin(math.pi * v / 2) + 1e-8) ** 0.2
    want = [radius * math.cos(2 * math.pi * h), radius * math.sin(2 * math.pi * h), v]
    got = hvi.to_hvi(torch.tensor([r, g, b], dtype=D))
    # Saturation is divided by I + 1e-8, which is felt where I itself is that small.
    assert got.tolist() == pytest.approx(want, abs=1e-7 if v > 0.1 else radius + 1e-9)


def test_hvi_by_hand():
    colours = torch.tensor([[0.0, 0, 0], [1, 1, 1], [1, 0, 0], [0, 1, 0]], dtype=D)
    third = 2 * math.pi / 3
    want = [[0, 0, 0], [0, 0, 1], [1, 0, 1], [math.cos(third), math.sin(third), 1]]
    assert_close(hvi.to_hvi(colours), torch.tensor(want, dtype=D), atol=1e-7, rtol=0)


def test_red_has_no_seam():
    a, b = (hvi.to_hvi(torch.tensor([1.0, g, bl], dtype=D)) for g, bl in ((1e-6, 0), (0, 1e-6)))
    assert float((a - b).abs().max()) < 1e-5


@pytest.mark.parametrize("colour", [[0.0, 0, 0], [0.5, 0.5, 0.5], [1.0, 1, 1]])
def test_grey_and_black_have_finite_gradients(colour):
    x = torch.tensor(colour, dtype=D, requires_grad=True)
    hvi.to_hvi(x).sum().backward()
    assert x.grad is not None
    assert x.grad.isfinite().all()


def test_hvi_gradient_away_from_ties():
    x = torch.tensor([[0.2, 0.5, 0.8], [0.9, 0.1, 0.4]], dtype=D, requires_grad=True)
    k = torch.tensor(0.3, dtype=D, requires_grad=True)
    assert torch.autograd.gradcheck(hvi.to_hvi, (x, k))


def picture(seed: int, h: int = 12, w: int = 13) -> torch.Tensor:
    return torch.rand(h, w, 3, generator=torch.Generator().manual_seed(seed), dtype=D)


def test_descriptor_of_black_is_zero_and_of_light_is_not():
    assert not hvi.descriptor(torch.zeros(4, 4, 3, dtype=D)).any()
    dim, bright = hvi.descriptor(0.2 * picture(0)), hvi.descriptor(picture(0))
    assert float(bright[2]) == pytest.approx(5 * float(dim[2]))


def test_descriptor_by_hand():
    """Mean, spread, 10 % and 90 % quantiles of H, V and I, in this order, by numpy."""
    image = picture(3)
    pixels = hvi.to_hvi(image).reshape(-1, 3).numpy()
    want = [pixels.mean(axis=0), pixels.std(axis=0), *np.quantile(pixels, [0.1, 0.9], axis=0)]
    assert_close(hvi.descriptor(image), torch.from_numpy(np.concatenate(want)))


def test_descriptor_ignores_where_pixels_are():
    image = picture(1)
    shuffled = image.reshape(-1, 3)[torch.randperm(156)].reshape(12, 13, 3)
    assert_close(hvi.descriptor(image), hvi.descriptor(shuffled))


@given(seed=st.integers(0, 2**16), strength=st.floats(0, 100))
@settings(max_examples=20)
def test_factor_stays_between_minus_one_and_one(seed, strength):
    weights = strength * torch.randn(12, 4, generator=torch.Generator().manual_seed(seed), dtype=D)
    factor = hvi.illumination_factor(picture(seed), weights)
    assert (factor.abs() <= 1).all()


def head_inputs(m: int, seed: int):
    g = torch.Generator().manual_seed(seed)
    head = mlp.create((3 + 4 + 5, 8, 8, 4), g, D)
    colours = torch.rand(m, 3, generator=g, dtype=D)
    return (
        head,
        colours,
        torch.randn(4, generator=g, dtype=D),
        torch.randn(m, 5, generator=g, dtype=D),
    )


@given(m=st.integers(0, 9), seed=st.integers(0, 2**16))
@settings(max_examples=30)
def test_adapted_colour_lies_between_the_colour_and_the_reference(m, seed):
    head, colours, factor, attended = head_inputs(m, seed)
    got = la.adapt_colours(head, colours, factor, attended)
    out = torch.stack(
        [mlp.evaluate(head, torch.cat([c, factor, f])[None])[0].sigmoid()
         for c, f in zip(colours, attended, strict=True)]
    ) if m else torch.zeros(0, 4, dtype=D)  # fmt: skip
    low, high = torch.minimum(colours, out[:, :3]), torch.maximum(colours, out[:, :3])
    assert ((got >= low - 1e-12) & (got <= high + 1e-12)).all()
    assert_close(got, out[:, 3:] * colours + (1 - out[:, 3:]) * out[:, :3])


def test_full_share_keeps_the_colour_to_the_bit():
    colours, reference = picture(0)[0], picture(1)[0]
    assert torch.equal(la.mix_colours(colours, reference, torch.ones(13, 1, dtype=D)), colours)


def test_the_light_of_the_view_reaches_the_colour():
    head, colours, factor, attended = head_inputs(4, 0)
    a, b = (la.adapt_colours(head, colours, f, attended) for f in (factor, -factor))
    assert not torch.allclose(a, b)


def test_colour_loss_against_scikit_image():
    adapted, original, truth = picture(0, 30, 31), picture(1, 30, 31), picture(2, 30, 31)
    padded = [torch.nn.functional.pad(x, (0, 0, 5, 5, 5, 5)).numpy() for x in (original, truth)]
    full: Any = structural_similarity(
        *padded, channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )[1]  # fmt: skip
    want = 0.8 * float((adapted - truth).abs().mean()) + 0.2 * (1 - full[5:-5, 5:-5].mean())
    assert float(la.colour_loss(adapted, original, truth)) == pytest.approx(want, abs=1e-6)


def test_volume_is_a_sum():
    assert float(la.volume_loss(torch.tensor([[1.0, 2, 3], [0.5, 1, 2]], dtype=D))) == 7
    assert float(la.volume_loss(torch.zeros(0, 3, dtype=D))) == 0


def test_dropout_keeps_its_share_and_repeats_with_its_seed():
    kept = la.dropout_mask(20000, 0.3, torch.Generator().manual_seed(0))
    # Binomial: standard deviation sqrt(0.21 / 20000) = 0.0032; four of them.
    assert float(kept.double().mean()) == pytest.approx(0.7, abs=0.013)
    assert torch.equal(kept, la.dropout_mask(20000, 0.3, torch.Generator().manual_seed(0)))
    assert la.dropout_mask(5, 0.0, torch.Generator().manual_seed(1)).all()
    for wrong in (-0.1, 1.0):
        with pytest.raises(ValueError, match="dropout"):
            la.dropout_mask(5, wrong, torch.Generator())


def test_dropout_loss_moves_the_dropped_render_only():
    dropped, full = (picture(k).requires_grad_() for k in (0, 1))
    la.dropout_loss(dropped, full).backward()
    assert full.grad is None
    assert dropped.grad is not None
    assert dropped.grad.any()
    assert float(la.dropout_loss(full, full).detach()) == pytest.approx(0, abs=1e-12)
