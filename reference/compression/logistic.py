"""The logistic function and its inverse as tables of integers, made from integers alone."""

from functools import cache

import numpy as np
from jaxtyping import Int16, UInt16

REACH = 2048
"""Entries of a table to either side of 0: arguments are 2^-8 apart, so that it reaches +-8."""
FRACTION = 96
"""Bits behind the point of the fixed-point numbers that the tables are made with."""


@cache
def squash() -> UInt16[np.ndarray, "4096"]:
    """Probability in 2^-16 at each argument: floor(2^16 / (1 + e^(-x / 256))), x = index - 2048.

    e^(-1/256) is summed from its series in Python's integers with 96 bits behind the point, and its
    powers are products, so no machine's floating point has a say.

    Source: ours; the mixing of bits in this domain is Mahoney 2005, "Adaptive weighing of context
    models for lossless data compression", Sec. 3.
    """
    one = 1 << FRACTION
    root, term = 0, one
    for n in range(1, 32):
        root += term
        term = -term // (256 * n)
    power, falling = one, []  # e^(-x / 256) for x = 0, 1, ...
    for _ in range(REACH + 1):
        falling.append(power)
        power = power * root >> FRACTION
    table = [(falling[-x] << 16) // (one + falling[-x]) for x in range(-REACH, 0)]
    table += [(one << 16) // (one + falling[x]) for x in range(REACH)]
    return np.array(table, dtype=np.uint16)


@cache
def stretch() -> Int16[np.ndarray, "4096"]:
    """Argument in 2^-8 at which `squash` reaches each probability (index + 1/2) 2^-12.

    The first argument whose probability is no smaller; the last one where none is.

    Source: ours.
    """
    middles = np.arange(4096, dtype=np.int64) * 16 + 8
    found = np.searchsorted(squash().astype(np.int64), middles)
    return (np.minimum(found, 2 * REACH - 1) - REACH).astype(np.int16)
