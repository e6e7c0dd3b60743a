"""An adaptive binary range coder: bits to bytes and back, given the probability of each bit.

The coder holds an interval [low, high] of 32-bit numbers. A bit whose probability of being 1 is
p / 2^16 cuts it at low + floor((high - low) p / 2^16): a 1 keeps what is below and the cut, a 0 what
is above. Bytes that both ends share are written (or read) and shifted out. A bit costs
-log2 of its probability; what rounding adds is below 0.01 %.
"""

from splatproof.base.errors import DataError

WHOLE = 0xFFFFFFFF


class RangeEncoder:
    """Bits to bytes.

    Source: ours, after the carry-free coder of Subbotin 1999 and the bitwise cut of Mahoney 2005.
    """

    def __init__(self) -> None:
        """Begin an empty stream."""
        self._low, self._high = 0, WHOLE
        self._bytes = bytearray()

    def bit(self, p: int, y: int) -> int:
        """Write one bit.

        Args:
            p: Probability of a 1 in 2^-16, within (0, 65536).
            y: The bit.
        """
        middle = self._low + ((self._high - self._low) * p >> 16)
        if y:
            self._high = middle
        else:
            self._low = middle + 1
        while (self._low ^ self._high) >> 24 == 0:
            self._bytes.append(self._high >> 24)
            self._low = self._low << 8 & WHOLE
            self._high = (self._high << 8 | 255) & WHOLE
        return y

    def finish(self) -> bytes:
        """All bytes of the stream; its last four are the low end of what is left."""
        return bytes(self._bytes) + self._low.to_bytes(4, "big")


class RangeDecoder:
    """Bytes to bits.

    Source: ours, see RangeEncoder.
    """

    def __init__(self, data: bytes) -> None:
        """Begin to read a stream.

        Raises: DataError if it is shorter than any stream is.
        """
        self._data, self._at = data, 0
        self._low, self._high, self._value = 0, WHOLE, 0
        for _ in range(4):
            self._next()

    def bit(self, p: int, y: int = 0) -> int:
        """Read one bit.

        Args:
            p: Probability of a 1 in 2^-16, as the writer had it.
            y: Not looked at.
        Raises: DataError where the stream has no more.
        """
        middle = self._low + ((self._high - self._low) * p >> 16)
        y = int(self._value <= middle)
        if y:
            self._high = middle
        else:
            self._low = middle + 1
        while (self._low ^ self._high) >> 24 == 0:
            self._low = self._low << 8 & WHOLE
            self._high = (self._high << 8 | 255) & WHOLE
            self._next()
        return y

    def finish(self) -> None:
        """Check that the stream ends here. Raises: DataError if it does not."""
        if self._at != len(self._data) or self._value != self._low:
            raise DataError("a stream that does not end where its codes do")

    def _next(self) -> None:
        if self._at == len(self._data):
            raise DataError("a stream that ends before its codes do")
        self._value = (self._value << 8 | self._data[self._at]) & WHOLE
        self._at += 1


Coder = RangeEncoder | RangeDecoder
"""What codes one bit: a writer is told it, a reader finds it, and both return it."""
