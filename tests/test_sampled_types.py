"""Tests check the annotated types of what they call: at first, and now and then in a loop."""

import jaxtyping
import pytest
import torch

from helpers.sampled_types import FIRST, count_from_zero
from splatproof.metrics.geometry import GeometryScores, vertical_faces

CALLS = 3 * FIRST
NORMALS, UP = torch.eye(3), torch.eye(3)[2]


@pytest.fixture(autouse=True)
def checked(pytestconfig: pytest.Config) -> None:
    if not pytestconfig.getoption("jaxtyping_packages"):
        pytest.skip("types are checked under --jaxtyping-packages alone")


def refused() -> list[int]:
    """Which of as many calls with a vector that has a coordinate too many are refused, from 1."""
    calls = []
    for call in range(1, CALLS + 1):
        try:
            vertical_faces(NORMALS, torch.zeros(4))
        except jaxtyping.TypeCheckError:
            calls.append(call)
        except RuntimeError:  # what torch says of the product, in calls that nobody checks
            pass
    return calls


@pytest.mark.parametrize("again", ["first", "second"])
def test_the_same_calls_are_checked_in_every_test(again):
    assert refused() == [*range(1, FIRST + 1), 2 * FIRST, 3 * FIRST], again


def test_a_wrong_shape_is_refused_and_a_right_one_is_not():
    assert vertical_faces(NORMALS, UP).tolist() == [True, True, False]
    with pytest.raises(jaxtyping.TypeCheckError, match="vertical_faces"):
        vertical_faces(NORMALS[:, :2], UP)
    count_from_zero()
    assert vertical_faces(NORMALS, UP).tolist() == [True, True, False]


def test_a_dataclass_is_checked_whenever_one_is_made():
    with pytest.raises(jaxtyping.TypeCheckError):
        GeometryScores(
            accuracy="0",  # pyrefly: ignore[bad-argument-type]
            completeness_distance=0.0,
            precision=0.0,
            completeness=0.0,
            f_score=0.0,
            chamfer=0.0,
        )
