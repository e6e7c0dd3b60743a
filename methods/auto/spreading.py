"""Some of many, evenly over their order."""

from collections.abc import Sequence


def spread(indices: Sequence[int], count: int) -> set[int]:
    """So many of some indices, evenly spread over their order.

    Args:
        indices: What is chosen from.
        count: How many, at most as many as there are.
    """
    return {indices[(2 * place + 1) * len(indices) // (2 * count)] for place in range(count)}


def evenly(indices: Sequence[int], most: int) -> tuple[int, ...]:
    """Some indices, evenly spread over their order and in it: all of them where there are no more than that.

    Args:
        indices: What is chosen from, rising.
        most: How many at most.
    """
    return tuple(sorted(spread(indices, min(most, len(indices)))))
