"""The part of a set's scene that a protocol uses: some cameras, a clip of a drive."""

from dataclasses import replace
from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.datasets.layout import Layout
from splatproof.reference.types.protocol import Protocol


def chosen_part(folder: Path, layout: Layout, protocol: Protocol) -> Layout:
    """The layout with the photos and sweeps that the protocol's `sensors` and `clips` leave.

    Args:
        folder: The scene's folder, whose name `clips` knows.
        layout: What the adapter read.
        protocol: The rules.
    Returns: The layout of what is used; its `left_out` names the photos that are not, and why.
    Raises: DataError for a camera that the scene does not have, or a clip beyond its end.
    """
    return _clipped(folder, _chosen_sensors(folder, layout, protocol), protocol)


def _chosen_sensors(folder: Path, layout: Layout, protocol: Protocol) -> Layout:
    if not protocol.sensors:
        return layout
    known = {photo.sensor for photo in layout.photos}
    for sensor in protocol.sensors:
        if sensor not in known:
            raise DataError(
                f"{folder}: has no camera {sensor!r}, which protocol {protocol.name} uses; "
                f"it has {', '.join(map(repr, sorted(known)))}"
            )
    reason = f"protocol {protocol.name} uses other cameras"
    others = [(p.name, reason) for p in layout.photos if p.sensor not in protocol.sensors]
    photos = [photo for photo in layout.photos if photo.sensor in protocol.sensors]
    return replace(layout, photos=photos, left_out=(*layout.left_out, *others))


def _clipped(folder: Path, layout: Layout, protocol: Protocol) -> Layout:
    """Photos and sweeps of the moments of the scene's clip."""
    name = folder.resolve().name
    clip = next(((first, last) for scene, first, last in protocol.clips if scene == name), None)
    if clip is None:
        return layout
    first, last = clip
    moments = sorted({photo.time for photo in layout.photos if photo.time is not None})
    if max(first, last) >= len(moments):
        raise DataError(
            f"{folder}: has {len(moments)} moments, but protocol {protocol.name} uses {first} to "
            f"{last if last >= 0 else 'the end'}; is the sequence whole?"
        )
    used = set(moments[first : last + 1 if last >= 0 else None])
    reason = f"protocol {protocol.name} uses moments {first} to {last if last >= 0 else 'the end'}"
    sweeps = [sweep for sweep in layout.sweeps if sweep.time in used]
    return replace(
        layout,
        photos=[photo for photo in layout.photos if photo.time in used],
        sweeps=sweeps,
        left_out=(
            *layout.left_out,
            *((photo.name, reason) for photo in layout.photos if photo.time not in used),
        ),
        facts=layout.facts | {"clip": f"{first} to {first + len(used) - 1}"},
    )
