"""Spread of opacity gradients: by hand, order, scale, bounds."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.reference.density.opacity_spread import spread, tallied


def draws(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).double()


def test_by_hand():
    gradients = torch.tensor([[1.0, 2.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 2.0, 0.0]]).double()
    drawn = torch.tensor([[True, True, False], [True, True, False], [False, True, False]])
    tallies = tallied(gradients, drawn)
    assert tallies.tolist() == [[0, 2, 2], [6, 12, 3], [0, 0, 0]]
    # 2 (2 / 3 - 0) and 3 (12 / 4 - (6 / 4)^2)
    assert spread(tallies).tolist() == pytest.approx([4 / 3, 2.25, 0])


def test_pixels_that_disagree_count_more_than_those_that_agree():
    drawn = torch.ones(40, 2, dtype=torch.bool)
    gradients = torch.ones(40, 2).double()
    gradients[:20, 0] = -1
    disputed, agreed = spread(tallied(gradients, drawn)).tolist()
    assert disputed > 30 * agreed


@given(seed=st.integers(0, 99), parts=st.integers(1, 4), scale=st.floats(1e-6, 1e6))
def test_order_and_parts_do_not_matter_and_it_grows_by_the_square(seed, parts, scale):
    gradients = draws(24, 5, seed=seed)
    drawn = draws(24, 5, seed=seed + 1) > -0.5
    gradients = gradients.where(drawn, 0)
    whole = spread(tallied(gradients, drawn))
    mixed = torch.randperm(24, generator=torch.Generator().manual_seed(seed))
    pieces = zip(gradients[mixed].chunk(parts), drawn[mixed].chunk(parts), strict=True)
    torch.testing.assert_close(spread(sum(tallied(*piece) for piece in pieces)), whole)  # type: ignore[arg-type]
    torch.testing.assert_close(spread(tallied(scale * gradients, drawn)), scale**2 * whole)
    assert (whole >= 0).all()
    assert (whole <= gradients.square().sum(dim=0) * (1 + 1e-9)).all()


def test_it_is_never_negative_where_rounding_would_make_it_so():
    # equal gradients of 1e4 pixels in float32: squares lose what the mean has
    tallies = torch.tensor([[1e4 * 0.3, 1e4 * 0.09, 1e4], [1e7, 0.999e10, 1e4], [0, 0, 0]])
    found = spread(tallies)
    assert found.isfinite().all()
    assert (found >= 0).all()
    assert found[2] == 0
