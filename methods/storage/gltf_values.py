"""Values of a .glb's accessors in float32, out of every type of component that KHR_gaussian_splatting allows."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from splatproof.base.errors import DataError

EXTENSION = "KHR_gaussian_splatting"
FLOAT = 5126
"""glTF's number for float32 components."""
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", FLOAT: "<f4"}
"""Types of components by glTF's numbers."""
SIGNED, UNSIGNED = [(5120, True), (5122, True)], [(5121, True), (5123, True)]
ALLOWED = {
    f"{EXTENSION}:ROTATION": SIGNED,
    f"{EXTENSION}:SCALE": [*UNSIGNED, (5121, False), (5123, False)],
    f"{EXTENSION}:OPACITY": UNSIGNED,
}
"""Components that an attribute may have beside float32, and whether they are normalised."""
WIDEST = 252
"""Bytes from a vertex to the next, at the most (glTF 2.0, Section 5.11.4)."""


def values(
    document: dict[str, Any], body: bytes, name: str, number: int, path: Path
) -> Float32[np.ndarray, "n k"]:
    """An accessor's values: normalised integers c as c / most, those with a sign no lower than -1.

    Args:
        document: The file's JSON.
        body: Its binary chunk.
        name: Attribute that the accessor is of.
        number: The accessor's index.
        path: The file, for errors.
    Raises: DataError for components that the attribute may not have; ValueError or KeyError for an accessor
        that does not lie inside the body.

    Source: Khronos, glTF 2.0, Sections 3.6.2.2 and 3.11, and the extension KHR_gaussian_splatting.
    """
    accessor = document["accessors"][number]
    kind, normalised = accessor["componentType"], accessor.get("normalized", False)
    if kind != FLOAT and (kind, normalised) not in ALLOWED.get(name, ()):
        raise DataError(
            f"{path}: {name} has {'normalised ' if normalised else ''}components of type {kind!r:.20}, which "
            f"{EXTENSION} does not allow there; write them as float32 ({FLOAT})"
        )
    if "sparse" in accessor:
        raise ValueError(f"accessor {number} is sparse")
    view = document["bufferViews"][accessor["bufferView"]]
    width = {name: k for k, name in TYPES.items()}[accessor["type"]]
    form = np.dtype(COMPONENTS[kind])
    stride = view.get("byteStride", width * form.itemsize)
    if not width * form.itemsize <= stride <= WIDEST:
        raise ValueError(f"accessor {number} has {stride!r:.20} bytes from a vertex to the next")
    found = np.ndarray(
        (accessor["count"], width), form, body, strides=(stride, form.itemsize),
        offset=view.get("byteOffset", 0) + accessor.get("byteOffset", 0),
    ).astype(np.float32)  # fmt: skip
    return np.maximum(found / np.iinfo(form).max, -1) if normalised and kind != FLOAT else found
