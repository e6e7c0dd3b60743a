"""Which views are held out, by a protocol's rule, and a hash that names the outcome."""

import difflib
import hashlib
from collections.abc import Sequence

from splatbench.reference.errors import DataError, UsageError
from splatbench.reference.protocol import Protocol


def split_views(
    names: Sequence[str], protocol: Protocol
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Indices of training and test views: test is every hold-th name (0, hold, 2 hold, ...).

    Args:
        names: Names of the registered views, sorted.
        protocol: `test_names` wins over `hold` when it is given; `hold` 0 holds nothing out.

    Returns: (train, test), each increasing; together all views.
    Raises:
        UsageError: a negative hold.
        DataError: a test name that is no view, or nothing left to train on.
    """
    if protocol.hold < 0:
        raise UsageError(f"protocol {protocol.name}: hold is {protocol.hold}, expected >= 0")
    if list(names) != sorted(names):
        raise ValueError("names must be sorted: the split is defined on the name-sorted views")
    if protocol.test_names:
        held = _named(names, protocol)
    else:
        held = set(range(0, len(names), protocol.hold)) if protocol.hold else set()
    train = tuple(i for i in range(len(names)) if i not in held)
    if not train:
        rule = f"test_names ({len(held)})" if protocol.test_names else f"hold {protocol.hold}"
        raise DataError(
            f"protocol {protocol.name}: {rule} leaves none of {len(names)} views for training; "
            "hold out fewer"
        )
    return train, tuple(sorted(held))


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
