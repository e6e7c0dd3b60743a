"""Evidence of several views: marks, what shows there, agreement and blame."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.reference.density.multi_view_error import blame, evidence, importance, marked


def draws(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed)).double()


def test_marks_by_hand():
    truth = torch.zeros(1, 4, 3)
    image = torch.tensor([0.0, 0.1, 0.2, 1.0])[None, :, None].repeat(1, 1, 3)
    assert marked(image, truth, 0.1).tolist() == [[False, False, True, True]]
    assert marked(image, truth, 1.0).tolist() == [[False] * 4]
    valid = torch.tensor([[True, True, True, False]])  # the range is 0 to 0.2 then
    assert marked(image, truth, 0.1, valid).tolist() == [[False, True, True, False]]


@given(seed=st.integers(0, 99), scale=st.floats(0.01, 1), threshold=st.floats(0.01, 0.99))
def test_marks_do_not_depend_on_how_large_all_errors_are(seed, scale, threshold):
    truth = torch.zeros(5, 6, 3).double()
    image = draws(5, 6, 3, seed=seed)
    assert torch.equal(marked(image, truth, threshold), marked(scale * image, truth, threshold))


def test_a_perfect_image_and_one_without_valid_pixels_have_no_marks():
    image = draws(4, 5, 3)
    assert not marked(image, image, 0.0).any()
    assert not marked(image + 0.5, image, 0.0).any() or (image + 0.5 - image).unique().numel() > 1
    nothing = torch.zeros(4, 5, dtype=torch.bool)
    assert not marked(image, 0 * image, 0.1, nothing).any()


@given(seed=st.integers(0, 99), count=st.integers(0, 7))
def test_evidence_is_at_most_the_marked_pixels_and_nothing_for_what_is_hidden(seed, count):
    weights, marks = draws(12, count, seed=seed), draws(12, seed=seed + 1) > 0.5
    if count:
        weights[:, 0] = 0
    found = evidence(weights, marks)
    assert (found <= marks.sum()).all()
    assert found[:1].sum() == 0
    assert not evidence(weights, torch.zeros_like(marks)).any()


@given(seed=st.integers(0, 99), times=st.integers(1, 4))
def test_importance_does_not_change_where_views_come_again_or_in_another_order(seed, times):
    found = draws(3, 9, seed=seed)
    torch.testing.assert_close(importance(found.repeat(times, 1)), importance(found))
    torch.testing.assert_close(importance(found.flip(0)), importance(found))


@given(seed=st.integers(0, 99))
def test_blame_is_from_0_to_1_and_orders_by_loss(seed):
    found, losses = draws(4, 9, seed=seed), draws(4, seed=seed + 1)
    share = blame(found, losses)
    assert (share.min(), share.max()) == (0, 1)
    assert torch.equal(share.argsort(), (losses @ found).argsort())


def test_nobody_is_blamed_where_all_are_alike():
    assert not blame(torch.ones(2, 5), torch.ones(2)).any()
    assert not blame(torch.zeros(2, 5), torch.ones(2)).any()
    assert not blame(torch.ones(2, 1), torch.ones(2)).any()
    assert blame(torch.zeros(2, 0), torch.ones(2)).tolist() == []
