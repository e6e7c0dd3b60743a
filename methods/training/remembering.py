"""Photos that are read once for all that looks at them."""

from dataclasses import replace
from functools import partial

from splatproof.datasets.image_cache import ImageCache
from splatproof.reference.types.scene import Scene


def remembering(scene: Scene, image_bytes: int) -> Scene:
    """The scene whose photos are read once for all that looks at them, as far as memory is allowed.

    Args:
        scene: The scene as a method gets it.
        image_bytes: Most bytes of photos that are kept.
    """
    cache = ImageCache(image_bytes)
    train = set(scene.train)
    views = tuple(
        replace(view, load=partial(cache.load, view)) if index in train else view
        for index, view in enumerate(scene.views)
    )
    return replace(scene, views=views)
