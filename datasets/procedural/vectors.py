"""Lengths of single vectors that are the same number on every machine."""

import numpy as np
from jaxtyping import Float


def norm(vector: Float[np.ndarray, " n"]) -> float:
    """Euclidean length, rounded alike on every machine.

    Without an axis numpy asks a library for the inner product, whose order of sums and fused multiplications follow the
    processor that it finds itself on. A texture coordinate that should be 0 came out on one side of it or the other,
    and pixels at the edges of church's windows were a level apart on two machines.

    Args:
        vector: Components.
    """
    return float(np.linalg.norm(vector, axis=0))
