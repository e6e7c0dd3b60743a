"""Scenes, opened by name or folder."""

from pathlib import Path

from splatproof.base.inside import allowing_outside, outside_is_allowed
from splatproof.datasets.catalogue import opening
from splatproof.metrics.protocol_files import load_protocol, resized
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene


def rules_of(protocol: str | Path | Protocol, width: int | None) -> Protocol:
    """The protocol that a caller means.

    Args:
        protocol: Name, path of a .toml file, or the rules themselves.
        width: Width of the images in pixels; None: the protocol's own.
    Raises: UsageError for an unknown name, a damaged file or a width below 1.
    """
    rules = protocol if isinstance(protocol, Protocol) else load_protocol(protocol)
    return resized(rules, width)


def open_scene(
    scene: str | Path,
    *,
    protocol: str | Path | Protocol = "default",
    width: int | None = None,
    allow_outside: bool = False,
) -> Scene:
    """Open a scene: views, their split, sparse points. No image is read yet.

    `view.load()` reads an image: float32 sRGB in [0, 1], height x width x 3. Cameras are pinhole,
    world to camera, OpenCV axes; lengths are in `scene.units`. A registered scene that the package
    makes itself is made at the first call (seconds to minutes) and kept in the cache.

    Args:
        scene: Folder of a scene in any layout that is read, or a name of `bench scenes list`; an
            existing folder goes first.
        protocol: Name of `bench protocols`, path of a .toml file, or the rules: sizes and split.
        width: Width of the images in pixels; None: the protocol's own.
        allow_outside: Read photos and masks that the scene's files name outside its folder, or that
            links lead to; only for scenes that you trust.
    Returns: The scene, its views sorted by name.
    Raises: DataError, naming the file, for a folder that is no scene or is damaged; UsageError for
        an unknown name; MissingError for a registered scene that has to be fetched first.
    Source: ours; layouts in docs/data_sets.md.
    """
    with allowing_outside(allow_outside or outside_is_allowed()):
        return opening.open_scene(scene, rules_of(protocol, width))
