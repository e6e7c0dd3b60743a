"""Which views are held out, by a protocol's rule, and a hash that names the outcome."""

import difflib
import hashlib
from collections.abc import Sequence

from splatbench.reference.errors import DataError, UsageError
from splatbench.reference.protocol import Protocol


def split_views(
    names: Sequence[str], protocol: Protocol, times: Sequence[float | None] = ()
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Indices of training and test views: test is every hold-th from hold_first on.

    Args:
        names: Names of the registered views, sorted.
        protocol: `test_names` wins over `hold` when it is given; `hold` 0 holds nothing out.
            With hold_unit "time" the sorted different times are counted instead of the names.
        times: Of each view, for hold_unit "time".

    Returns: (train, test), each increasing; together all views.
    Raises:
        UsageError: a negative hold.
        DataError: a test name that is no view, a view without a time where times are counted,
            or nothing left to train on.
    """
    for key in ("hold", "hold_first"):
        if getattr(protocol, key) < 0:
            raise UsageError(
                f"protocol {protocol.name}: {key} is {getattr(protocol, key)}, expected >= 0"
            )
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
    return train, tuple(sorted(held))


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
    """Indices of the protocol's test names."""
    index = {name: i for i, name in enumerate(names)}
    for name in protocol.test_names:
        if name not in index:
            near = difflib.get_close_matches(name, names, n=1, cutoff=0.0)
            raise DataError(
                f"protocol {protocol.name}: test view {name!r} is not among the {len(names)} "
                f"registered views; nearest is {near[0] if near else 'none'!r}"
            )
    return {index[name] for name in protocol.test_names}


def split_hash(names: Sequence[str], test: Sequence[int]) -> str:
    """Sha256 of the lines "train NAME" and "test NAME" in name order: equal splits, equal hash."""
    held = set(test)
    lines = [f"{'test' if i in held else 'train'} {name}\n" for i, name in enumerate(names)]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
