"""How long this process has read photos, by what was done.

Threads read them beside the training, so that what it takes is no stage of a run: it is counted where it is spent.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from threading import Lock

PARTS: tuple[str, ...] = ("decode", "undistort", "resize")
"""What is done to a photo, in this order: see `truth_image`."""


class ReadingClock:
    """Wall seconds of each part, of all threads together."""

    def __init__(self) -> None:
        """Nothing has been read."""
        self._lock, self._spent = Lock(), dict.fromkeys(PARTS, 0.0)

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Count what the block takes, if it ends well.

        Args:
            part: One of PARTS.
        """
        began = time.perf_counter()
        yield
        spent = time.perf_counter() - began
        with self._lock:
            self._spent[part] += spent

    def seconds(self) -> dict[str, float]:
        """What each part has taken so far."""
        with self._lock:
            return dict(self._spent)

    def since(self, earlier: Mapping[str, float]) -> dict[str, float]:
        """What each part has taken since an earlier moment.

        Args:
            earlier: What `seconds` said then.
        """
        return {part: spent - earlier[part] for part, spent in self.seconds().items()}


READING = ReadingClock()
"""The clock of this process, that all views of all scenes count on."""
