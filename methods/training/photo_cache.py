"""Photos of a training in bounded memory: those that fit stay, and a few pass through."""

from collections.abc import Callable, Sequence

from torch import Tensor

from splatproof.datasets.image_cache import TensorCache
from splatproof.methods.training.ahead import FAR, PHOTO_BYTES
from splatproof.methods.training.image_room import ImageRoom
from splatproof.methods.training.resolution import shrunk
from splatproof.reference.types.scene import View


class PhotoCache:
    """What a trainer reads of its views, up to a number of bytes; safe for several threads.

    Steps look at the photos in rounds, each in a new order: the least recently used is the next one as likely as any, and dropping
    it leaves next to none that is found again. So what is kept stays. A photo for which there is no room takes the place of
    one that was as little kept, and so one that is read ahead is there when its step comes. While photos are small their small
    sizes have the room first, and photos of full size, of which the next size is made, what is left; when steps have outgrown
    a size it leaves.
    """

    def __init__(self, room: ImageRoom, views: Sequence[View]) -> None:
        """Start empty, for photos of their full size.

        Args:
            room: Bytes that are kept, and whether photos are read ahead.
            views: What is trained on.
        """
        sizes = sorted(_bytes(view) for view in views)
        middle = sizes[len(sizes) // 2] if sizes else 0
        self._views, self.limit, self.factor = tuple(views), room.kept, 1.0
        self._own = {(view.name, view.size) for view in views}
        self.passing = min(room.kept, (1 + FAR * room.ahead) * middle)
        """Bytes for what passes through: the present photo and those that are read ahead, of the size of the one in the middle."""
        self._passing = TensorCache(self.passing)
        self._whole = TensorCache(self.limit - self.passing, drops=False)
        self._small = TensorCache(0, drops=False)

    @property
    def held(self) -> int:
        """Bytes held now; what lies in two places counts twice."""
        return self._passing.held + self._whole.held + self._small.held

    def resize(self, factor: float) -> None:
        """Make room for photos as small as steps look at from now on; those of another small size leave.

        Args:
            factor: Factor, >= 1, by which photos are shrunk.
        """
        if factor == self.factor:
            return
        room, self.factor = self.limit - self.passing, factor
        small = sum(_bytes(shrunk(view, factor)) for view in self._views) if factor > 1 else 0
        small = min(room, small)
        self._small = TensorCache(0, drops=False)  # gone before others have its room
        self._whole.bound(room - small)
        self._small = TensorCache(small, drops=False)

    def get(self, key: tuple[str, tuple[int, int], str], make: Callable[[], Tensor]) -> Tensor:
        """Return the tensor of a key, from memory or by calling `make`; not to be written into.

        Args:
            key: Name of a view, (height, width), and what of the view it is.
            make: Computes the tensor where it is not kept.
        """
        kept = self._whole if key[:2] in self._own else self._small
        return kept.get(key, lambda: self._passing.get(key, make))


def _bytes(view: View) -> int:
    """Bytes of a view's photo, and of its mask where there is one."""
    return (PHOTO_BYTES + (view.load_mask is not None)) * view.camera.width * view.camera.height
