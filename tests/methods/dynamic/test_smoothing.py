"""Smoothing in time: how often, how far, and how fast things move on the whole."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.methods.contracts.model import TRAINED, Moment
from splatproof.methods.dynamic.smoothing import average_velocities, skipped


def test_it_is_drawn_as_often_as_asked_within_reach_and_never_afterwards():
    moment = Moment(step=1, total=9, generator=torch.Generator().manual_seed(0))
    drawn = torch.tensor([skipped(moment, 0.3, 0.03) for _ in range(2000)])
    assert int((drawn != 0).sum()) == pytest.approx(600, abs=80)  # 4 standard deviations
    assert float(drawn.abs().max()) == pytest.approx(0.03, rel=0.05)
    assert abs(float(drawn.mean())) < 2e-3
    assert skipped(TRAINED, 1.0, 0.03) == 0
    assert skipped(moment, 0.0, 0.03) == 0


@given(span=st.floats(1e-3, 1e4), period=st.floats(1e-3, 10), decay=st.floats(0, 5))
def test_what_stays_long_moves_nowhere_and_what_passes_moves_at_its_velocity(span, period, decay):
    velocities = torch.tensor([[1.0, -2.0, 3.0]])
    slow = average_velocities(velocities, torch.tensor([span]), period, decay)
    share = math.exp(-decay * span / (2 * period))
    torch.testing.assert_close(slow, velocities * share)
    assert bool((slow.abs() <= velocities.abs()).all())
    shorter = average_velocities(velocities, torch.tensor([span / 2]), period, decay)
    assert bool((shorter.abs() >= slow.abs()).all())
