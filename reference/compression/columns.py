"""Columns of small codes as a stream, with the codes of near Gaussians and columns as contexts."""

import numpy as np
from jaxtyping import Int32

from splatproof.reference.compression.mixing import Mixing
from splatproof.reference.compression.range_coder import Coder, RangeDecoder, RangeEncoder

MOST_SLOTS = 1 << 18
MOST_BITS = 12
"""Bits of a code, at the most."""
PRIME = 1031
"""Two numbers that are one context: a PRIME + b."""


def encode_columns(
    codes: Int32[np.ndarray, "c n"],
    bits: Int32[np.ndarray, " c"],
    nearest: Int32[np.ndarray, "n 3"],
    side: Int32[np.ndarray, " n"],
) -> bytes:
    """Codes in [0, 2^bits), column after column, each as a binary tree from its highest bit.

    With v the codes of the three nearest before (half the range where there is none), m = (2 v_1 +
    v_2 + v_3) / 4, and a, b the codes of this Gaussian one and two columns before (else 0), the
    contexts are none; v_1; (m / 2, a / 2); (a / 2, b / 2); (side, m / 4).

    Args:
        codes: Codes of each column.
        bits: Bits of each column's codes, 0 to 12.
        nearest: Indices from gaps.nearest_before.
        side: A number of each Gaussian that the reader knows, >= 0.

    Source: ours.
    """
    coder = RangeEncoder()
    _columns(coder, codes.tolist(), bits.tolist(), nearest.tolist(), side.tolist())
    return coder.finish()


def decode_columns(
    data: bytes,
    bits: Int32[np.ndarray, " c"],
    nearest: Int32[np.ndarray, "n 3"],
    side: Int32[np.ndarray, " n"],
) -> Int32[np.ndarray, "c n"]:
    """The columns of a stream.

    Args:
        data: What encode_columns returned.
        bits: Bits of each column's codes, 0 to 12.
        nearest: Indices from gaps.nearest_before.
        side: As the writer had it.

    Raises: DataError if it is not a stream of such columns.

    Source: ours.
    """
    coder = RangeDecoder(data)
    codes = [[0] * len(nearest) for _ in bits]
    _columns(coder, codes, bits.tolist(), nearest.tolist(), side.tolist())
    coder.finish()
    return np.array(codes, dtype=np.int32).reshape(len(bits), len(nearest))


def _columns(
    coder: Coder, codes: list[list[int]], bits: list[int], nearest: list[list[int]], side: list[int]
) -> None:
    """Code the columns in place: a writer is told them, a reader finds them."""
    for c, (own, depth) in enumerate(zip(codes, bits, strict=True)):
        model = Mixing(5, min(MOST_SLOTS, 1 << 2 * depth))
        for i, near in enumerate(nearest):
            v = [own[j] if j >= 0 else 1 << depth >> 1 for j in near]
            mean = 2 * v[0] + v[1] + v[2] >> 2
            a = codes[c - 1][i] if c > 0 else 0
            b = codes[c - 2][i] if c > 1 else 0
            pairs = ((mean >> 1, a >> 1), (a >> 1, b >> 1), (side[i], mean >> 2))
            contexts = [x << depth for x in (0, v[0], *(p * PRIME + q for p, q in pairs))]
            node = 1
            for bit in range(depth - 1, -1, -1):
                node = node << 1 | model.code(coder, contexts, node, own[i] >> bit & 1)
            own[i] = node - (1 << depth)
