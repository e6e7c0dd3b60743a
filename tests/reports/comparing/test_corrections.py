"""Corrections: against examples by hand, and intervals that agree with the corrected p-values."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatproof.reports.comparing.corrections import corrected, levels

P_VALUES = st.lists(st.floats(0, 1), min_size=1, max_size=30)
BOTH = pytest.mark.parametrize("correction", ["holm", "benjamini-hochberg"])


def test_holm_by_hand():
    assert corrected([0.01, 0.04, 0.03, 0.005], "holm") == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_benjamini_hochberg_by_hand():
    found = corrected([0.01, 0.04, 0.03, 0.005], "benjamini-hochberg")
    assert found == pytest.approx([0.02, 0.04, 0.04, 0.02])


@BOTH
def test_no_comparison_needs_no_correction(correction):
    assert corrected([], correction) == []
    assert levels([], correction, 0.05) == []
    assert corrected([0.03], correction) == [0.03]
    assert levels([0.03], correction, 0.05) == [0.05]


@BOTH
@given(P_VALUES)
def test_an_interval_excludes_0_exactly_where_the_corrected_p_says_so(correction, p_values):
    """An interval at level a excludes 0 where p < a; both ways to read a result must agree."""
    found, held = corrected(p_values, correction), levels(p_values, correction, 0.05)
    for p, corrected_p, level in zip(p_values, found, held, strict=True):
        assert 0 < level <= 0.05
        assert p <= corrected_p <= 1
        if abs(p - level) > 1e-12:
            assert (p < level) == (corrected_p <= 0.05), (p, corrected_p, level)


@BOTH
@given(P_VALUES, st.randoms())
def test_order_is_of_no_account(correction, p_values, random):
    order = list(range(len(p_values)))
    random.shuffle(order)
    found = corrected(p_values, correction)
    shuffled = corrected([p_values[i] for i in order], correction)
    assert shuffled == pytest.approx([found[i] for i in order])


def test_more_comparisons_never_make_holm_milder():
    rng = np.random.default_rng(0)
    p_values = list(rng.uniform(0, 0.1, 8))
    fewer, more = corrected(p_values, "holm"), corrected([*p_values, 0.5, 1e-9], "holm")
    assert all(b >= a for a, b in zip(fewer, more, strict=False))
