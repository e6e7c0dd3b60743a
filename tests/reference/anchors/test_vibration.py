import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.testing import assert_close

from splatproof.reference.anchors import vibration

D = torch.float64
times = st.floats(-100, 100)
periods = st.floats(0.05, 50)


def anchors(n: int, seed: int):
    g = torch.Generator().manual_seed(seed)
    centres, velocities = torch.randn(2, n, 3, generator=g, dtype=D)
    return centres, velocities, torch.randn(n, generator=g, dtype=D)


@given(n=st.integers(0, 5), seed=st.integers(0, 2**16), time=times, period=periods)
def test_motion_repeats_is_bounded_and_rests_without_velocity(n, seed, time, period):
    centres, velocities, peaks = anchors(n, seed)
    here = vibration.vibrate(centres, velocities, peaks, time, period)
    later = vibration.vibrate(centres, velocities, peaks, time + period, period)
    # The sine's argument is rounded: 2 pi (t - tau) / p is below 2e4 here, so 2e4 eps times reach.
    assert_close(here, later, atol=1e-9, rtol=0)
    reach = velocities.norm(dim=1) * period / (2 * math.pi)
    assert ((here - centres).norm(dim=1) <= reach + 1e-12).all()
    still = vibration.vibrate(centres, 0 * velocities, peaks, time, period)
    assert_close(still, centres)


@given(seed=st.integers(0, 2**16), period=periods)
def test_at_the_peak_it_is_home_and_moves_with_its_velocity(seed, period):
    centres, velocities, peaks = anchors(3, seed)
    for i in range(3):
        tau = float(peaks[i])
        one = (centres[i : i + 1], velocities[i : i + 1], peaks[i : i + 1])
        assert_close(vibration.vibrate(*one, tau, period), one[0])
        step = 1e-5 * period
        ahead, back = (vibration.vibrate(*one, tau + s, period) for s in (step, -step))
        assert_close((ahead - back) / (2 * step), one[1], atol=1e-5, rtol=1e-6)


@given(seed=st.integers(0, 2**16), offset=st.floats(0, 30), span=st.floats(0.01, 10))
def test_life_is_one_at_the_peak_and_symmetric(seed, offset, span):
    _, _, peaks = anchors(1, seed)
    spans, tau = torch.full((1,), span, dtype=D), float(peaks)
    assert float(vibration.life(peaks, spans, tau)) == 1
    after = float(vibration.life(peaks, spans, tau + offset))
    assert after == pytest.approx(float(vibration.life(peaks, spans, tau - offset)), abs=1e-9)
    assert 0 <= after <= 1


def test_life_by_hand():
    # One span away: exp(-1/2).
    got = vibration.life(torch.tensor([2.0], dtype=D), torch.tensor([0.5], dtype=D), 2.5)
    assert float(got) == pytest.approx(math.exp(-0.5))


def test_gradients():
    centres, velocities, peaks = (x.requires_grad_() for x in anchors(3, 0))
    spans = torch.tensor([0.3, 1.0, 4.0], dtype=D, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda c, v, p: vibration.vibrate(c, v, p, 0.7, 1.3), (centres, velocities, peaks)
    )
    assert torch.autograd.gradcheck(lambda p, s: vibration.life(p, s, 0.7), (peaks, spans))


@pytest.mark.parametrize("period", [0.0, -1.0, math.nan])
def test_period_must_be_positive(period):
    with pytest.raises(ValueError, match="period"):
        vibration.vibrate(*anchors(2, 0), 0.0, period)


def test_span_must_be_positive():
    with pytest.raises(ValueError, match="life spans"):
        vibration.life(torch.zeros(2), torch.tensor([1.0, 0.0]), 0.0)
