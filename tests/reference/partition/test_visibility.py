"""Which views a block needs, against sets of point ids."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.clouds import tracked
from splatproof.reference.partition import visibility

TRACKS = st.lists(st.lists(st.integers(0, 6), unique=True), max_size=30)
SHARES = st.floats(0, 1)


@settings(max_examples=80)
@given(tracks=TRACKS, data=st.data(), view_share=SHARES, block_share=SHARES)
def test_covering_views_are_those_of_the_sets(tracks, data, view_share, block_share):
    chosen = data.draw(st.lists(st.booleans(), min_size=len(tracks), max_size=len(tracks)))
    block = {i for i, held in enumerate(chosen) if held}
    want = []
    for view in range(8):  # the last one sees nothing
        seen = {i for i, views in enumerate(tracks) if view in views}
        both = len(seen & block)
        want.append(
            both > 0 and (both / len(seen) >= view_share or both / len(block) >= block_share)
        )
    found = visibility.covering_views(
        tracked(tracks), torch.tensor(chosen).bool(), 8,
        view_share=view_share, block_share=block_share,
    )  # fmt: skip
    assert found.tolist() == want


@settings(max_examples=30)
@given(tracks=TRACKS, low=SHARES, high=SHARES)
def test_larger_shares_take_fewer_views(tracks, low, high):
    low, high = sorted((low, high))
    points = tracked(tracks)
    chosen = torch.arange(len(tracks)) % 2 == 0
    few, many = (
        visibility.covering_views(points, chosen, 7, view_share=s, block_share=s)
        for s in (high, low)
    )
    assert not (few & ~many).any()


def test_a_share_is_reached_by_equality():
    # View 0 sees 2 points, one of them the block's; the block has 2, one of them seen by view 1.
    points = tracked([[0, 1], [0, 2], [2]])
    chosen = torch.tensor([True, False, True])
    by_view = visibility.covering_views(points, chosen, 3, view_share=0.5, block_share=2.0)
    by_block = visibility.covering_views(points, chosen, 3, view_share=2.0, block_share=0.5)
    assert by_view.tolist() == [True, True, True]
    assert by_block.tolist() == [True, True, True]
    assert visibility.covering_views(
        points, chosen, 3, view_share=0.51, block_share=2.0
    ).tolist() == [False, True, False]


def test_track_lengths_and_shared_points_by_hand():
    points = tracked([[0, 1], [], [1, 2, 3], [1]])
    assert visibility.track_lengths(points).tolist() == [2, 0, 3, 1]
    chosen = torch.tensor([True, False, True, False])
    assert visibility.shared_points(points, chosen, 5).tolist() == [1, 2, 1, 1, 0]
