import pytest

from splatbench.datasets.splits import split_hash, split_views
from splatbench.reference.errors import DataError, UsageError
from splatbench.reference.protocol import Protocol

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
    ],
)
def test_split(rules, test):
    train, held = split_views(NAMES, protocol(**rules))
    assert held == test
    assert sorted(train + held) == list(range(18))


def test_an_unknown_test_name_gets_its_nearest():
    with pytest.raises(DataError, match="'img_9.jpg' is not among the 18.*'img_09.jpg'"):
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
    base = split_hash(NAMES, (0, 8, 16))
    assert base == split_hash(list(NAMES), (16, 0, 8))
    assert base != split_hash(NAMES, (0, 8))
    assert base != split_hash([*NAMES[:-1], "other.jpg"], (0, 8, 16))
    assert len(base) == 64


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
