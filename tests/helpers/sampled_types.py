"""Annotated shapes and types are checked while tests run; in a loop of hundreds of steps, not at every step.

Under pytest's option `--jaxtyping-packages` every function of our rooms checks what it is given and what it gives.
Making these checks took nearly half of what a worker's imports take, and running them a fifth of a test that trains.
So a function's checks are made when it is first called, and in each test its first `FIRST` calls are
checked, and one of `FIRST` after them: the same ones whatever ran before.
"""

import functools
from collections.abc import Callable
from types import CodeType

import jaxtyping

FIRST = 32
"""So many calls of each function in each test are checked, then one of as many."""

_counts: dict[CodeType, list[int]] = {}
"""By function: the number of the test that called it last, and how often that has so far. To look it up by the
function at each call takes three times as long as all else does: a function's code is hashed anew each time."""
_test = 0
_at_every_call = jaxtyping.jaxtyped


def sample_types() -> None:
    """Have what is imported from now on checked so; what is imported already stays as it is."""
    # of jaxtyped's forms, that one which the import hook writes
    jaxtyping.jaxtyped = _jaxtyped  # pyrefly: ignore[bad-assignment]


def count_from_zero() -> None:
    """A test begins."""
    global _test
    _test += 1


def _jaxtyped(*, typechecker: Callable) -> Callable:
    """What the import hook decorates functions and classes with."""

    def decorate(made: Callable) -> Callable:
        if isinstance(
            made, type
        ):  # a dataclass, whose __init__ is checked: few, and no loop of any
            return _at_every_call(made, typechecker=typechecker)
        count = _counts.setdefault(made.__code__, [_test, 0])
        checked: list[Callable] = []

        @functools.wraps(made)
        def sampled(*args: object, **kwargs: object) -> object:
            __tracebackhide__ = True
            if count[0] != _test:
                count[:] = _test, 0
            count[1] += 1
            if count[1] > FIRST and count[1] % FIRST:
                return made(*args, **kwargs)
            if not checked:
                checked.append(_at_every_call(made, typechecker=typechecker))
            return checked[0](*args, **kwargs)

        return sampled

    return decorate
