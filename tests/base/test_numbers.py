"""Numbers from outside: finite, in range, small enough to be stored."""

from dataclasses import dataclass, field

import pytest

from splatproof.base.errors import DataError, UsageError
from splatproof.base.numbers import LARGEST, check_numbers, image_size, in_range

NAN, INF, HUGE = float("nan"), float("inf"), 10**400


@dataclass(frozen=True)
class Inner:
    rate: float = 1.0
    sizes: tuple[int, ...] = (1, 2)


@dataclass(frozen=True)
class Outer:
    steps: int = 3
    named: dict[str, float] = field(default_factory=dict)
    inner: Inner = field(default_factory=Inner)
    words: str = "nan"


@pytest.mark.parametrize("value", [NAN, INF, -INF, HUGE, -1, 11, "3", None, True])
def test_a_number_out_of_its_range(value):
    with pytest.raises(DataError, match=r"^here is .{1,70}, expected from 0 to 10$"):
        in_range(value, "here", 0, 10, fault=DataError)


def test_the_ends_of_a_range():
    for value in (0, 10, 0.5):
        in_range(value, "here", 0, 10)
    with pytest.raises(UsageError, match=r"here is 0, expected above 0$"):
        in_range(0, "here", above=True)
    in_range(LARGEST, "here")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (NAN, "--x is nan, expected a finite number"),
        (2**70, "--x is a whole number of 71 bits, expected at most"),
        (HUGE, "--x is a whole number of 1329 bits"),
        (Outer(steps=-(2**63)), "--x.steps is a whole number of 64 bits"),
        (Outer(named={"a": INF}), "--x.named.a is inf"),
        (Outer(inner=Inner(rate=NAN)), "--x.inner.rate is nan"),
        (Outer(inner=Inner(sizes=(1, 2**64))), r"--x.inner.sizes.\[1\] is a whole number"),
        ([{"a": [NAN]}], r"is nan"),
    ],
)
def test_numbers_are_found_wherever_they_are(value, said):
    with pytest.raises(UsageError, match=said):
        check_numbers(value, "--x")


def test_what_is_fine():
    for value in (Outer(), True, None, "inf", [1, 2.5, {"a": -LARGEST}], Outer):
        check_numbers(value, "--x")


@pytest.mark.parametrize(
    "side", [0, -1, NAN, INF, 1e300, 2**40, 2**80, HUGE, "96", None, True, 1e5]
)
def test_sizes_of_no_image(side):
    for sides in ((side, 72), (72, side)):
        with pytest.raises(DataError, match=r"^here: (width|height) is .{1,70}, expected pixels"):
            image_size(*sides, "here")
    assert image_size(96.0, 72, "here") == (96, 72)
