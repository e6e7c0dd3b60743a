"""Photos that come next are read by a thread of their own while a step is computed."""

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from splatproof.reference.types.scene import View

FAR = 2
"""Photos beyond the present one that are read ahead."""
PHOTO_BYTES = 12
"""Bytes a pixel of a photo in memory: three channels of float32."""


class Ahead:
    """Reads the next photos into a bounded cache, in order, on one thread.

    What is read is what a step would read, so nothing but time depends on it: a photo that cannot be read
    is left to the step, which says why.
    """

    def __init__(self, read: Callable[[View], object], room: int) -> None:
        """Wait for the first photo.

        Args:
            read: Puts the photo of a view into a cache, safe for several threads.
            room: Bytes of that cache. A photo is read ahead only where the present one, it and those before
                it fit: others would be dropped before they are looked at.
        """
        self._read, self._room = read, room
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="photos ahead")
        self._asked: list[Future[object]] = []

    def close(self) -> None:
        """Read no further photo; one that is being read is waited for."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def look(self, present: View, coming: Iterable[View]) -> None:
        """Ask for the next photos; does not wait, and asks for nothing while earlier ones are being read.

        Args:
            present: The view that the step looks at.
            coming: Views in the order in which they come; a few are looked at.
        """
        self._asked = [one for one in self._asked if not one.done()]
        if self._asked:
            return
        used = _bytes(present)
        for view, _ in zip(coming, range(FAR), strict=False):
            used += _bytes(view)
            if used > self._room:
                break
            self._asked.append(self._pool.submit(self._read, view))


def _bytes(view: View) -> int:
    return PHOTO_BYTES * view.camera.width * view.camera.height
