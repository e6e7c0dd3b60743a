import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional
from torch.testing import assert_close

from splatproof.reference.anchors import attention as aa

D = torch.float64


def anchors(n: int, seed: int):
    g = torch.Generator().manual_seed(seed)
    centres = torch.randn(n, 3, generator=g, dtype=D)
    features = torch.randn(n, 7, generator=g, dtype=D)
    return features, centres, aa.create(7, 5, g, D)


def test_fourier_code_by_hand():
    got = aa.fourier_code(torch.tensor([[0.1, 0.0, 0.75]], dtype=D))
    assert got.shape == (1, 24)
    assert float(got[0, 0]) == pytest.approx(math.sin(0.2 * math.pi))
    assert float(got[0, 5]) == pytest.approx(math.cos(1.5 * math.pi))
    # Second octave, phase pi / 2: sin(2 pi 2 x + pi / 2) = cos(4 pi x).
    assert float(got[0, 6]) == pytest.approx(math.cos(0.4 * math.pi))
    assert float(got[0, 18]) == pytest.approx(math.sin(2 * math.pi * 0.8 + math.pi / 2))


def test_no_two_stations_of_a_tunnel_look_alike():
    """200 stations along the scene; only the two ends of the box meet."""
    places = torch.zeros(200, 3, dtype=D)
    places[:, 1] = torch.linspace(-40, 60, 201, dtype=D)[:-1]
    low, high = torch.tensor([-1.0, -40, -1], dtype=D), torch.tensor([1.0, 60, 1], dtype=D)
    codes = aa.fourier_code(aa.in_box(places, low, high))
    apart = torch.cdist(codes, codes) + 9 * torch.eye(200, dtype=D)
    # Neighbours differ by 2 pi / 200 radians in the lowest octave, and by 2, 4, 8 times that.
    step = math.hypot(*(2 * math.sin(math.pi * 2**octave / 200) for octave in range(4)))
    assert float(apart.min()) == pytest.approx(step)


def test_in_box_by_hand():
    low, high = torch.tensor([-1.0, 0, 2], dtype=D), torch.tensor([1.0, 4, 3], dtype=D)
    got = aa.in_box(torch.tensor([[-1.0, 1, 2.5], [0, 9, -9]], dtype=D), low, high)
    assert_close(got, torch.tensor([[0.0, 0.25, 0.5], [0.5, 1, 0]], dtype=D))
    assert (got < 1).all()
    with pytest.raises(ValueError, match="box"):
        aa.in_box(got, low, low)


@pytest.mark.parametrize("place", [-0.5, 1.0, math.nan])
def test_places_that_would_alias_are_refused(place):
    with pytest.raises(ValueError, match="period 1"):
        aa.fourier_code(torch.tensor([[0.5, place, 0.5]], dtype=D))


def test_gates_by_loop():
    features, _, weights = anchors(5, 0)
    kernel = torch.tensor([0.2, 0.5, -0.3], dtype=D)
    weights = replace(weights, anchor_kernel=torch.tensor([1.5], dtype=D), feature_kernel=kernel)
    got = aa.pooled_gates(features, weights)
    for i in range(5):
        for j in range(7):
            row = torch.sigmoid(1.5 * features[i].mean())
            total = sum(
                kernel[o + 1] * features[:, j + o].mean() for o in (-1, 0, 1) if 0 <= j + o < 7
            )
            want = features[i, j] * row * torch.sigmoid(torch.as_tensor(total))
            assert float(got[i, j]) == pytest.approx(float(want))


@given(n=st.integers(1, 10), seed=st.integers(0, 2**16), radius=st.floats(0, 3))
@settings(max_examples=30)
def test_attention_matches_torch_with_a_mask(n, seed, radius):
    features, centres, weights = anchors(n, seed)
    mask = torch.cdist(centres, centres) <= radius
    mask |= torch.eye(n, dtype=torch.bool)
    want = functional.scaled_dot_product_attention(
        (features @ weights.query)[None], (features @ weights.key)[None],
        (features @ weights.value)[None], attn_mask=mask[None],
    )[0]  # fmt: skip
    assert_close(aa.local_attention(features, centres, radius, weights), want)


@given(n=st.integers(1, 10), seed=st.integers(0, 2**16))
@settings(max_examples=30)
def test_permuting_anchors_permutes_the_result(n, seed):
    features, centres, weights = anchors(n, seed)
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed))

    def run(f: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
        return aa.local_attention(aa.pooled_gates(f, weights), c, 1.0, weights)

    assert_close(run(features[order], centres[order]), run(features, centres)[order])


@pytest.mark.parametrize("n", [1, 6])
def test_radius_zero_passes_the_value_through(n):
    features, centres, weights = anchors(n, 3)
    got = aa.local_attention(features, centres, 0.0, weights)
    assert_close(got, features @ weights.value)


def test_an_isolated_anchor_sees_itself_and_is_seen_by_none():
    features, centres, weights = anchors(6, 4)
    centres[0] += 100
    got = aa.local_attention(features, centres, 5.0, weights)
    assert_close(got[0], features[0] @ weights.value)
    changed = features.clone()
    changed[0] += 1
    assert_close(aa.local_attention(changed, centres, 5.0, weights)[1:], got[1:])


def test_an_anchor_at_exactly_the_radius_is_seen():
    features, _, weights = anchors(2, 5)
    centres = torch.tensor([[0.0, 0, 0], [2.0, 0, 0]], dtype=D)
    seen, hidden = (
        aa.local_attention(features, centres, radius, weights) for radius in (2.0, 1.999)
    )
    assert not torch.allclose(seen, hidden)


def test_no_anchor_is_no_feature():
    features, centres, weights = anchors(0, 0)
    assert aa.local_attention(features, centres, 1.0, weights).shape == (0, 5)


def test_negative_radius_is_refused():
    features, centres, weights = anchors(2, 0)
    with pytest.raises(ValueError, match="radius"):
        aa.local_attention(features, centres, -1.0, weights)


def test_gradients():
    features, centres, weights = anchors(4, 6)
    inputs = [x.requires_grad_() for x in (features, weights.query, weights.key, weights.value)]

    def run(f, q, k, v):
        w = replace(weights, query=q, key=k, value=v)
        return aa.local_attention(aa.pooled_gates(f, w), centres, 1.5, w)

    assert torch.autograd.gradcheck(run, inputs)
