"""Signed codes of view-dependent colour as a stream: most are 0, and contexts know where not."""

import numpy as np
from jaxtyping import Int32

from splatproof.base.errors import DataError
from splatproof.reference.compression.mixing import Mixing
from splatproof.reference.compression.range_coder import Coder, RangeDecoder, RangeEncoder

CLASSES = 7
"""Classes of step (quantisers.classes)."""
ENERGIES = 24
NODES = 16
"""Bits of a code that are predicted: not 0, below 0, and larger than 1 to 14."""
UNARY = 15
"""Codes from here on are written plain, as what they exceed it by in Elias's gamma code."""
SLOTS = 1 << 12
MOST_PLAIN = 20


def encode_harmonics(
    codes: Int32[np.ndarray, "d n"],
    nearest: Int32[np.ndarray, "n 3"],
    classes: Int32[np.ndarray, " n"],
) -> bytes:
    """Codes of d = 3 k columns, coefficient after coefficient and in each channel after channel.

    With e = min(23, floor(3 log2(1 + sum of the sizes of this Gaussian's codes so far))), z its
    class, v the codes of the three nearest before in steps of this class, and the codes of this
    Gaussian one channel before (a; of the first channel: two coefficients before), two channels
    before (b; of the first two: one coefficient before) and one coefficient before (c), the
    contexts are none; (e, z); 2 v_1 + v_2 + v_3; (a, e); (a, b); (c, e).

    Args:
        codes: Codes of each column, sizes up to 2^20.
        nearest: Indices from gaps.nearest_before.
        classes: Class of each Gaussian's step, 0 to 6.

    Source: ours.
    """
    coder = RangeEncoder()
    _harmonics(coder, codes.tolist(), nearest.tolist(), classes.tolist())
    return coder.finish()


def decode_harmonics(
    data: bytes,
    columns: int,
    nearest: Int32[np.ndarray, "n 3"],
    classes: Int32[np.ndarray, " n"],
) -> Int32[np.ndarray, "d n"]:
    """The columns of a stream.

    Args:
        data: What encode_harmonics returned.
        columns: Their number d, a multiple of 3.
        nearest: Indices from gaps.nearest_before.
        classes: Class of each Gaussian's step, 0 to 6.

    Raises: DataError if it is not a stream of such columns.

    Source: ours.
    """
    coder = RangeDecoder(data)
    codes = [[0] * len(nearest) for _ in range(columns)]
    _harmonics(coder, codes, nearest.tolist(), classes.tolist())
    coder.finish()
    return np.array(codes, dtype=np.int32).reshape(columns, len(nearest))


def _harmonics(
    coder: Coder, codes: list[list[int]], nearest: list[list[int]], classes: list[int]
) -> None:
    """Code the columns in place: a writer is told them, a reader finds them."""
    energy, zeros = [0] * len(nearest), [0] * len(nearest)
    for column, own in enumerate(codes):
        model, channel = Mixing(6, SLOTS), column % 3
        before = codes[column - 3] if column >= 3 else zeros
        left = codes[column - 1] if channel > 0 else codes[column - 6] if column >= 6 else zeros
        far = codes[column - 2] if channel > 1 else before
        for i, near in enumerate(nearest):
            z = classes[i]
            v = [_rescaled(own[j], classes[j] - z) if j >= 0 else 0 for j in near]
            e = min(ENERGIES - 1, ((1 + energy[i]) ** 3).bit_length() - 1)
            a, b, c = left[i], far[i], before[i]
            contexts = [
                place * NODES
                for place in (
                    0, e * CLASSES + z, _within(2 * v[0] + v[1] + v[2], 12),
                    _within(a, 3) * ENERGIES + e, _within(a, 3) * 7 + _within(b, 3),
                    _within(c, 3) * ENERGIES + e,
                )
            ]  # fmt: skip
            own[i] = _signed(coder, model, contexts, own[i])
            energy[i] = min(255, energy[i] + abs(own[i]))


def _signed(coder: Coder, model: Mixing, contexts: list[int], code: int) -> int:
    """One code."""
    if not model.code(coder, contexts, 0, int(code != 0)):
        return 0
    negative, size, most = model.code(coder, contexts, 1, int(code < 0)), 1, abs(code)
    while size < UNARY and model.code(coder, contexts, min(size + 1, NODES - 1), int(most > size)):
        size += 1
    if size == UNARY:
        rest, seen = most - UNARY + 1, 0
        while coder.bit(1 << 15, int(seen < rest.bit_length() - 1)):
            seen += 1
            if seen > MOST_PLAIN:
                raise DataError("a stream that holds a code that is too large")
        value = 1
        for bit in range(seen - 1, -1, -1):
            value = value << 1 | coder.bit(1 << 15, rest >> bit & 1)
        size += value - 1
    return -size if negative else size


def _rescaled(code: int, finer: int) -> int:
    """A code in steps that are 2^finer times as fine, rounded towards 0."""
    size = abs(code)
    scaled = min(size, 1 << 16) << finer if finer >= 0 else size >> -finer
    return -scaled if code < 0 else scaled


def _within(x: int, most: int) -> int:
    """A number from 0 for -most and below to 2 most for most and above."""
    return min(max(x, -most), most) + most
