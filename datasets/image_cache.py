"""Bounded memory: values are made when asked for; without room the least recently used go, or new ones are not kept."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial
from threading import Lock

from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.reference.types.scene import View


class TensorCache:
    """Tensors up to a number of bytes, by default those that were last asked for; safe for several threads.

    Two threads that ask for the same key at once compute it once; a tensor larger than the
    whole bound is returned and not kept. Callers must not write into what they get.
    """

    def __init__(self, limit: int, *, drops: bool = True) -> None:
        """Start empty.

        Args:
            limit: Most bytes kept; 0 keeps nothing.
            drops: Whether the least recently used tensors make room for new ones. False: what is kept stays,
                and what finds no room is made each time. Of more tensors than fit that are asked for in rounds,
                each in a new order, as many as fit are found then; dropping leaves next to none until it is asked for.
        Raises: UsageError if limit is negative.
        """
        if limit < 0:
            raise UsageError(f"cache limit is {limit} bytes, expected >= 0")
        self.limit, self.drops = limit, drops
        self.held = 0
        self._kept: OrderedDict[Hashable, Tensor] = OrderedDict()
        self._making: dict[Hashable, Lock] = {}
        self._lock = Lock()

    def __reduce__(self) -> tuple[partial["TensorCache"], tuple[int]]:
        """Sent to another process it starts empty there."""
        return partial(TensorCache, drops=self.drops), (self.limit,)

    def __len__(self) -> int:
        """Return the number of tensors kept."""
        return len(self._kept)

    def bound(self, limit: int) -> None:
        """Keep at most so many bytes from now on; what was least recently asked for leaves until that holds.

        Args:
            limit: Most bytes kept.
        """
        with self._lock:
            self.limit = limit
            self._leave(0)

    def get(self, key: Hashable, make: Callable[[], Tensor]) -> Tensor:
        """Return the tensor of a key, from memory or by calling `make`.

        Args:
            key: Names the tensor.
            make: Computes the tensor where it is not kept; not called otherwise.
        """
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            making = self._making.setdefault(key, Lock())
        with making:
            with self._lock:
                if key in self._kept:  # another thread made it while this one waited
                    self._kept.move_to_end(key)
                    return self._kept[key]
            try:
                value = make()
                self._keep(key, value)
            finally:
                with self._lock:
                    self._making.pop(key, None)
        return value

    def _keep(self, key: Hashable, value: Tensor) -> None:
        size = value.numel() * value.element_size()
        with self._lock:
            if size > self.limit or not self.drops and self.held + size > self.limit:
                return
            self._leave(size)
            self._kept[key] = value
            self.held += size

    def _leave(self, size: int) -> None:
        """Drop until so many bytes find room."""
        while self._kept and self.held + size > self.limit:
            _, dropped = self._kept.popitem(last=False)
            self.held -= dropped.numel() * dropped.element_size()


class ImageCache:
    """Images of views as float32, exactly what `View.load` returns, in bounded memory."""

    def __init__(self, limit: int) -> None:
        """Start empty.

        Args:
            limit: Most bytes of images kept; an image takes 12 bytes a pixel.
        """
        self._cache = TensorCache(limit)

    @property
    def held(self) -> int:
        """Bytes of images held now."""
        return self._cache.held

    def load(self, view: View) -> Tensor:
        """Return the view's image; do not write into it. Views are told apart by identity."""
        return self._cache.get(view, view.load)
