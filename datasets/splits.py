"""A protocol's rules say which views train and which are scored; a hash names the outcome."""

import fnmatch
import hashlib
from collections.abc import Sequence

from splatproof.base.errors import DataError, UsageError
from splatproof.base.names import did_you_mean
from splatproof.reference.types.protocol import Protocol

Split = tuple[tuple[int, ...], tuple[int, ...]]
"""Indices of the views that train and of those that are scored, each increasing."""


def split_views(
    names: Sequence[str], protocol: Protocol, times: Sequence[float | None] = ()
) -> Split:
    """Indices of training and test views: test is every hold-th from hold_first on.

    Args:
        names: Names of the registered views, sorted.
        protocol: `test_names` wins over `hold` when it is given; `hold` 0 holds nothing out.
            With hold_unit "time" the sorted different times are counted instead of the names.
            `train_views` and `scored` are applied then (see `chosen_views`).
        times: Seconds of each view (None: unknown); read for hold_unit "time" alone.

    Returns: (train, test), each increasing.
    Raises:
        UsageError: a negative number.
        DataError: a test name that is no view, a view without a time where times are counted,
            or nothing left to train on.
    """
    for key in ("hold", "hold_first"):
        _check(protocol, key)
    if list(names) != sorted(names):
        raise ValueError("names must be sorted: the split is defined on the name-sorted views")
    if protocol.test_names:
        held = _named(names, protocol)
    else:
        held = _every(names, protocol, times) if protocol.hold else set()
    train = tuple(i for i in range(len(names)) if i not in held)
    if not train:
        rule = f"test_names ({len(held)})" if protocol.test_names else f"hold {protocol.hold}"
        raise DataError(
            f"protocol {protocol.name}: {rule} leaves none of {len(names)} views for training; "
            "hold out fewer"
        )
    return chosen_views(train, tuple(sorted(held)), protocol)


def chosen_views(train: tuple[int, ...], test: tuple[int, ...], protocol: Protocol) -> Split:
    """What `train_views` and `scored` make of a split.

    Args:
        train: Views that are not held out.
        test: Held-out views; empty: those that `train_views` leaves over are.
        protocol: The rules.
    Raises: UsageError for a negative `train_views`; DataError where there are too few views.
    """
    _check(protocol, "train_views")
    count = protocol.train_views
    if count:
        if count > len(train) - (not test):
            raise DataError(
                f"protocol {protocol.name}: trains on {count} views, but there are {len(train)}"
                f"{'' if test else ' and at least one must be left to test on'}; take fewer"
            )
        kept = tuple(train[i] for i in spread_evenly(len(train), count))
        test = test or tuple(sorted(set(train) - set(kept)))
        train = kept
    return train, train if protocol.scored == "training" else test


def spread_evenly(size: int, count: int) -> list[int]:
    """Indices at equal steps, both ends among them: i-th = floor(i (size - 1) / (count - 1) + 1/2).

    Args:
        size: Number of things to choose from; indices are 0 to size - 1.
        count: How many to choose, 1 to size; 1 chooses the middle.
    Source: ours.
    """
    if count == 1:
        return [(size - 1) // 2]
    steps = count - 1
    return [(2 * i * (size - 1) + steps) // (2 * steps) for i in range(count)]


def _check(protocol: Protocol, key: str) -> None:
    if getattr(protocol, key) < 0:
        raise UsageError(
            f"protocol {protocol.name}: {key} is {getattr(protocol, key)}, expected >= 0"
        )


def _every(names: Sequence[str], protocol: Protocol, times: Sequence[float | None]) -> set[int]:
    """Indices of every hold-th view, or of all views of every hold-th moment."""
    first, step = protocol.hold_first, protocol.hold
    if protocol.hold_unit == "view":
        return set(range(first, len(names), step))
    known = [time for time in times if time is not None]
    if len(known) < len(names):
        raise DataError(
            f"protocol {protocol.name}: counts moments, but {len(names) - len(known)} of "
            f"{len(names)} views have no time; take a protocol whose hold_unit is 'view'"
        )
    held = set(sorted(set(known))[first::step])
    return {i for i, time in enumerate(times) if time in held}


def _named(names: Sequence[str], protocol: Protocol) -> set[int]:
    """Indices of the protocol's test names; a name that is no view may be a pattern of some."""
    index = {name: i for i, name in enumerate(names)}
    held = set()
    for name in protocol.test_names:
        found = [name] if name in index else fnmatch.filter(names, name)
        if not found:
            raise DataError(
                f"protocol {protocol.name}: test view {name!r} is not among the {len(names)} "
                f"registered views{did_you_mean(name, names)}"
            )
        held |= {index[one] for one in found}
    return held


def split_hash(names: Sequence[str], train: Sequence[int], test: Sequence[int]) -> str:
    """Sha256 of a line ROLE NAME for each view in name order: equal splits, equal hash.

    A view's role is train, test, "train test" where it is both, or none.

    Args:
        names: Names of all views, sorted.
        train: Indices of the training views.
        test: Indices of the scored views.
    """
    roles = [(set(train), "train"), (set(test), "test")]
    lines = [
        f"{' '.join(role for members, role in roles if i in members) or 'none'} {name}\n"
        for i, name in enumerate(names)
    ]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
