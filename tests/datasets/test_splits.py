import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.base.errors import DataError, UsageError
from splatproof.datasets.splits import split_hash, split_views, spread_evenly
from splatproof.reference.types.protocol import Protocol

NAMES = [f"img_{i:02d}.jpg" for i in range(18)]


def protocol(**rules) -> Protocol:
    return Protocol(name="test", source="test", **rules)


@pytest.mark.parametrize(
    ("rules", "test"),
    [
        ({}, (0, 8, 16)),
        ({"hold": 5}, (0, 5, 10, 15)),
        ({"hold": 0}, ()),
        ({"hold": 18}, (0,)),
        ({"test_names": ("img_09.jpg", "img_03.jpg")}, (3, 9)),
        ({"test_names": ("img_09.jpg",), "hold": 2}, (9,)),
        ({"test_names": ("img_1*", "img_03.jpg")}, (3, *range(10, 18))),
    ],
)
def test_split(rules, test):
    train, held = split_views(NAMES, protocol(**rules))
    assert held == test
    assert sorted(train + held) == list(range(18))


def test_an_unknown_test_name_gets_its_nearest():
    with pytest.raises(
        DataError, match="'img_9.jpg' is not among the 18.*did you mean 'img_09.jpg'"
    ):
        split_views(NAMES, protocol(test_names=("img_9.jpg",)))


@pytest.mark.parametrize("rules", [{"hold": 1}, {"test_names": tuple(NAMES)}])
def test_a_split_without_training_views_is_refused(rules):
    with pytest.raises(DataError, match="none of 18 views for training"):
        split_views(NAMES, protocol(**rules))


def test_a_negative_hold_is_refused():
    with pytest.raises(UsageError, match="hold is -8"):
        split_views(NAMES, protocol(hold=-8))


def test_unsorted_names_are_our_own_mistake():
    with pytest.raises(ValueError, match="sorted"):
        split_views(NAMES[::-1], protocol())


def test_the_hash_names_the_split():
    train, test = (1, 2, 3), (0, 8, 16)
    base = split_hash(NAMES, train, test)
    assert base == split_hash(list(NAMES), train[::-1], (16, 0, 8))
    others = [
        split_hash(NAMES, train, (0, 8)),
        split_hash(NAMES, (1, 2), test),
        split_hash([*NAMES[:-1], "other.jpg"], train, test),
        split_hash(NAMES, test, train),
        split_hash(NAMES, (*train, *test), test),
    ]
    assert len({base, *others}) == 6
    assert len(base) == 64


def test_a_name_with_brackets_is_a_name_first():
    names = ["a1.jpg", "a[1].jpg", "b.jpg"]
    assert split_views(names, protocol(test_names=("a[1].jpg",)))[1] == (1,)
    assert split_views(["a1.jpg", "b.jpg"], protocol(test_names=("a[1].jpg",)))[1] == (0,)


@given(size=st.integers(1, 300), count=st.integers(1, 300))
@settings(deadline=None)
def test_spread_evenly(size, count):
    count = min(size, count)
    chosen = spread_evenly(size, count)
    assert len(set(chosen)) == count
    assert chosen == sorted(chosen)
    assert 0 <= chosen[0] <= chosen[-1] < size
    if count > 1:
        assert (chosen[0], chosen[-1]) == (0, size - 1)
        # each is the place nearest to an equal step, so two steps differ by at most one
        assert np.abs(np.array(chosen) - np.linspace(0, size - 1, count)).max() <= 0.5 + 1e-9
        assert np.ptp(np.diff(chosen)) <= 1
    # the same from either end, up to the rounding of halves
    back = [size - 1 - i for i in reversed(chosen)]
    assert max(abs(a - b) for a, b in zip(chosen, back, strict=True)) <= 1


@given(size=st.integers(2, 40), count=st.integers(1, 40), hold=st.sampled_from([0, 3, 8]))
@settings(deadline=None)
def test_few_training_views(size, count, hold):
    names = [f"{i:03d}" for i in range(size)]
    rules = protocol(train_views=count, hold=hold, hold_first=1 if size > 3 else 0)
    everything, held = split_views(names, protocol(hold=hold, hold_first=rules.hold_first))
    if count > len(everything) - (not held):
        with pytest.raises(DataError, match=f"trains on {count} views, but there are"):
            split_views(names, rules)
        return
    train, test = split_views(names, rules)
    assert len(train) == count
    assert set(train) <= set(everything)
    if held:  # what is held out does not depend on how many train: fewer views stay comparable
        assert test == held
    else:
        assert sorted(train + test) == list(range(size))


def test_published_numbers_of_views():
    names = [f"{i:03d}.png" for i in range(21)]
    train, test = split_views(names, protocol(train_views=3, hold=0))
    assert train == (0, 10, 20)
    assert len(test) == 18
    assert split_views(names, protocol(train_views=1, hold=0))[0] == (10,)
    with pytest.raises(UsageError, match="train_views is -1, expected >= 0"):
        split_views(names, protocol(train_views=-1))


def test_training_views_can_be_scored():
    train, scored = split_views(NAMES, protocol(hold=6, scored="training"))
    assert train == scored == split_views(NAMES, protocol(hold=6))[0]
    everything, scored = split_views(NAMES, protocol(hold=0, scored="training"))
    assert everything == scored == tuple(range(18))


def test_moments_are_counted_with_all_their_views():
    names = [f"{camera}_{i}" for camera in "ab" for i in range(9)]
    times = [0.1 * i for _ in "ab" for i in range(9)]
    rules = protocol(hold=4, hold_first=3, hold_unit="time")
    train, held = split_views(names, rules, times)
    assert [names[i] for i in held] == ["a_3", "a_7", "b_3", "b_7"]
    assert sorted(train + held) == list(range(18))
    assert split_views(names, protocol(hold=4, hold_first=3), times)[1] == (3, 7, 11, 15)
    with pytest.raises(DataError, match="counts moments, but 1 of 18 views have no time"):
        split_views(names, rules, [None, *times[1:]])
    with pytest.raises(DataError, match="18 of 18 views have no time"):
        split_views(names, rules)
    with pytest.raises(UsageError, match="hold_first is -1, expected >= 0"):
        split_views(names, protocol(hold_first=-1))
