"""Prediction of a bit by mixing what several contexts say, in integers."""

from collections import defaultdict
from collections.abc import Sequence

from splatproof.reference.compression.logistic import squash, stretch
from splatproof.reference.compression.range_coder import Coder

FRESH = (1 << 23, 0)
"""Probability in 2^-24 of a slot that was never seen, and how often it was."""
MOST_SEEN = 254
START = 4096
"""Weight of each context at the start: 1/4 in 2^-14."""
LIMIT = 1 << 17
"""Largest size of a weight: sums of eight stay within 32 bits."""
LEARNING = 16
"""Bits by which error times argument is shifted before a weight follows it."""


class Mixing:
    """An adaptive model of bits: one slot a context and node, one set of weights a node.

    Slot i says p_i, in the logistic domain s_i = stretch(p_i) n / (n + 0.6) after it was seen n
    times. The bit is a 1 with p = squash(sum_i w_i s_i). Then each slot moves by
    (bit - p_i) / (n + 1.5), n at most 254, and each weight by (bit - p) s_i / 2^16: gradient
    descent on the bits that the bit costs. All of it in integers: p_i in 2^-24, s_i in 2^-8, w_i in
    2^-14, p in 2^-16.

    Source: Mahoney 2005, "Adaptive weighing of context models for lossless data compression",
    Sec. 3; the numbers: ours.
    """

    def __init__(self, inputs: int, slots: int) -> None:
        """Begin with nothing seen.

        Args:
            inputs: Number of contexts, at most 8.
            slots: Slots of each context's table, a power of two: contexts beyond share them.
        """
        self._mask = slots - 1
        self._slots: list[dict[int, tuple[int, int]]] = [
            defaultdict(lambda: FRESH) for _ in range(inputs)
        ]
        self._weights: dict[int, list[int]] = defaultdict(lambda: [START] * inputs)
        self._stretch, self._squash = stretch().tolist(), squash().tolist()

    def code(self, coder: Coder, contexts: Sequence[int], node: int, y: int) -> int:
        """Code one bit and learn from it.

        Args:
            coder: Writer or reader.
            contexts: First slot of each context.
            node: Which bit of a symbol this is; added to each context.
            y: The bit, when it is written.
        """
        weights, said, places = self._weights[node], [], []
        for context, slots in zip(contexts, self._slots, strict=True):
            place = context + node & self._mask
            p, seen = slots[place]
            trust = 2560 * seen // (10 * seen + 6)
            said.append(self._stretch[p >> 12] * trust >> 8)
            places.append(place)
        total = sum(w * s for w, s in zip(weights, said, strict=True)) >> 14
        p = self._squash[min(max(total, -2047), 2047) + 2048]
        y = coder.bit(p, y)
        error = (65536 if y else 0) - p
        target = 0xFFFFFF if y else 0
        for i, (slots, place) in enumerate(zip(self._slots, places, strict=True)):
            moved = weights[i] + (error * said[i] + (1 << LEARNING - 1) >> LEARNING)
            weights[i] = min(max(moved, -LIMIT), LIMIT)
            at, seen = slots[place]
            rate = 32768 // (2 * seen + 3)
            slots[place] = at + ((target - at >> 7) * rate >> 7), min(seen + 1, MOST_SEEN)
        return y
