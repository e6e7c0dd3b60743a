"""Gaussians as .glb: binary glTF 2.0 with the extension KHR_gaussian_splatting."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes, size_of, whole_file
from splatproof.methods.models.explicit import check_gaussians
from splatproof.methods.storage.gltf_values import EXTENSION, FLOAT, TYPES, values
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians

OURS = "splatproof"
"""Key of the node's extras that holds shift and mode, which the extension has no place for."""
POINTS = 0
"""glTF's number for primitives that are points."""
LOOK = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
"""What the extension must say of its Gaussians for them to be ours."""
STILL = {"matrix": [[float(i % 5 == 0) for i in range(16)]], "translation": [[0, 0, 0]],
         "rotation": [[0, 0, 0, 1], [0, 0, 0, -1]], "scale": [[1, 1, 1]]}  # fmt: skip
"""Values of a node's properties that move nothing."""
HEAD, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
LARGEST = 1 - 2.0**-24
"""Largest opacity that float32 tells from 1, whose logit would be infinite."""
TINIEST = 1e-37
"""Smallest scale whose logarithm float32 gives; a scale of 0 is allowed in the file."""


def write_gltf(
    path: str | Path,
    gaussians: Gaussians,
    shift: Float[Tensor, "3"] | None = None,
    mode: Mode = "classic",
) -> None:
    """Write a binary glTF whose one primitive is the Gaussians, activated, in float32.

    Scales are linear and opacities in [0, 1], as the extension's ratified text has them; its drafts
    had logarithms of scales. The harmonics are those of the 3DGS release, whose basis has the
    extension's signs, and colours are display-referred sRGB. Positions stay in the model's frame:
    viewers compute in float32, so the shift stands beside them instead of in them. glTF's own
    axes have y up; no turn is written, since the model does not know which way is up.

    Args:
        path: The file, written whole or not at all.
        gaussians: The model, in float32.
        shift: Vector in scene units, float64; added to positions it gives those in the original
            frame. None: zero.
        mode: How the model is rasterized; the extension knows "classic" alone, ours reads it back.

    Raises: DataError for a model of no Gaussians, which glTF has no place for, or of more than 4 GiB.

    Source: Khronos, glTF 2.0, section 4.4 (GLB), and the extension KHR_gaussian_splatting.
    """
    path = Path(path)
    if not len(gaussians):
        raise DataError(f"{path}: 0 Gaussians. Expected at least one")
    columns = _columns(gaussians)
    views, accessors, at = [], [], 0
    for column in columns.values():
        views.append({"buffer": 0, "byteOffset": at, "byteLength": column.nbytes, "target": 34962})
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": FLOAT, "count": len(column),
             "type": TYPES[column.shape[1]]}
        )  # fmt: skip
        at += column.nbytes
    position = columns["POSITION"]
    accessors[0] |= {"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()}
    told = {"shift": [0.0] * 3 if shift is None else shift.double().tolist(), "mode": mode}
    look = LOOK | {"sortingMethod": "cameraDistance", "projection": "perspective"}
    primitive = {"mode": POINTS, "attributes": {name: i for i, name in enumerate(columns)},
                 "extensions": {EXTENSION: look}}  # fmt: skip
    document = {
        "asset": {"version": "2.0", "generator": "splatproof"},
        "extensionsUsed": [EXTENSION], "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "extras": {OURS: told}}], "meshes": [{"primitives": [primitive]}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": at}],
    }  # fmt: skip
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    length = HEAD.size + 2 * CHUNK.size + len(text) + at
    if length >= 2**32:
        raise DataError(f"{path}: {length} bytes; a .glb holds less than 4 GiB, write a .ply")
    with whole_file(path) as partial, partial.open("wb") as file:
        file.write(HEAD.pack(b"glTF", 2, length))
        file.write(CHUNK.pack(len(text), b"JSON") + text)
        file.write(CHUNK.pack(at, b"BIN\0"))
        for column in columns.values():
            file.write(column.tobytes())


def read_gltf(path: str | Path) -> tuple[Gaussians, Float[Tensor, "3"], Mode]:
    """The Gaussians of a .glb file, its shift and how they are rasterized.

    Opacities beyond 1 - 2^-24 come back as that, scales below 1e-37 as 1e-37.

    Args:
        path: A file with one primitive of the extension, of ellipses in display-referred sRGB, under nodes
            that do not move it, in any type of number that the extension allows; of this project or
            another tool.
    Returns: The Gaussians in float32, the float64 shift to add to their means (zero where the file
        says none) and the mode ("classic" where it says none).
    Raises: DataError, in one line, naming the file and the fault.
    """
    path = Path(path)
    document, body = _chunks(path)
    try:
        node, primitive = _primitive(document, path)
        found = primitive["attributes"]
        columns = {
            name: values(document, body, name, found[name], path) for name in found if _known(name)
        }
        degree = max(d for d in range(4) if f"{EXTENSION}:SH_DEGREE_{d}_COEF_0" in found)
        told = node.get("extras", {}).get(OURS, {})
        shift = torch.tensor(told.get("shift", [0.0] * 3), dtype=torch.float64)
        mode = told.get("mode", "classic")
        _check_ranges(columns, path)
        sh = np.stack([columns[name] for name in _harmonics(degree)], axis=1)
        model = Gaussians(
            means=_tensor(columns["POSITION"]),
            # glTF's quaternions end with the real part, ours begin with it
            quaternions=_tensor(columns[f"{EXTENSION}:ROTATION"]).roll(1, dims=1),
            log_scales=_tensor(columns[f"{EXTENSION}:SCALE"]).clamp_min(TINIEST).log(),
            opacity_logits=_tensor(columns[f"{EXTENSION}:OPACITY"])[:, 0]
            .double().clamp(TINIEST, LARGEST).logit().float(),
            sh=_tensor(sh),
        )  # fmt: skip
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DataError(f"{path}: not a whole .glb of Gaussians ({error!r})") from None
    if shift.shape != (3,) or not shift.isfinite().all() or mode not in ("classic", "antialiased"):
        raise DataError(f"{path}: extras say shift {told.get('shift')!r} and mode {mode!r}")
    check_gaussians(model, path)
    return model, shift, mode


def _columns(gaussians: Gaussians) -> dict[str, Float32[np.ndarray, "n k"]]:
    """Values of each attribute, in the file's order."""
    turned = gaussians.unit_quaternions.roll(-1, dims=1)
    columns = {
        "POSITION": gaussians.means,
        f"{EXTENSION}:ROTATION": turned,
        f"{EXTENSION}:SCALE": gaussians.log_scales.exp(),
        f"{EXTENSION}:OPACITY": gaussians.opacities[:, None],
    }
    names = _harmonics(gaussians.degree)
    columns |= dict(zip(names, gaussians.sh.unbind(dim=1), strict=True))
    return {n: np.ascontiguousarray(v.detach().numpy(), "<f4") for n, v in columns.items()}


def _check_ranges(columns: dict[str, Float32[np.ndarray, "n k"]], path: Path) -> None:
    """Refuse scales below 0 and opacities beyond 0 and 1."""
    for name, most, said in (
        (
            "SCALE",
            np.inf,
            "0 or more: a draft of the extension had logarithms, write the file anew",
        ),
        ("OPACITY", 1.0, "0 to 1: write the file anew"),
    ):
        column = columns[f"{EXTENSION}:{name}"]
        beyond = column[(column < 0) | (column > most)]
        if len(beyond):
            raise DataError(f"{path}: {name} of {beyond[0]:.9g}, expected {said}")


def _harmonics(degree: int) -> list[str]:
    """Attributes of the harmonics, in the order of `Gaussians.sh`: m from -l to l for each l."""
    return [
        f"{EXTENSION}:SH_DEGREE_{d}_COEF_{n}" for d in range(degree + 1) for n in range(2 * d + 1)
    ]


def _known(name: str) -> bool:
    return name == "POSITION" or name.startswith(f"{EXTENSION}:")


def _tensor(values: Float32[np.ndarray, "..."]) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float32))


def _chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk of a .glb file."""
    try:
        stored = size_of(path)
        with path.open("rb") as file:
            magic, version, length = HEAD.unpack(file.read(HEAD.size))
        if magic != b"glTF" or version != 2 or length != stored:
            raise ValueError(f"{stored} bytes that begin {magic!r}, expected a whole .glb")
        content = read_bytes(path)
        size, kind = CHUNK.unpack_from(content, HEAD.size)
        start = HEAD.size + CHUNK.size
        document = json.loads(content[start : start + size])
        rest, binary = CHUNK.unpack_from(content, start + size)
        if (kind, binary) != (b"JSON", b"BIN\0") or not isinstance(document, dict):
            raise ValueError("expected one chunk of JSON and one of binary data")
        start += size + CHUNK.size
        return document, content[start : start + rest]
    except (ValueError, RecursionError, struct.error) as error:
        raise DataError(f"{path}: not a whole .glb file ({error})") from None


def _primitive(document: dict[str, Any], path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The primitive of the extension and the node that shows it."""
    meshes = document["meshes"]
    found = [
        (number, primitive)
        for number, mesh in enumerate(meshes)
        for primitive in mesh["primitives"]
        if EXTENSION in primitive.get("extensions", {})
    ]
    if len(found) != 1:
        raise DataError(f"{path}: {len(found)} primitives with {EXTENSION}, expected one")
    number, primitive = found[0]
    if primitive["extensions"][EXTENSION].get("extensions"):
        raise DataError(
            f"{path}: its Gaussians are compressed by another extension; unpack it first"
        )
    for name, expected in LOOK.items():
        if (told := primitive["extensions"][EXTENSION].get(name)) != expected:
            raise DataError(
                f"{path}: {name} of its Gaussians is {told!r:.80}, expected {expected!r}; convert it "
                "with the tool that wrote it"
            )
    nodes = document["nodes"]
    shown = [i for i, node in enumerate(nodes) if node.get("mesh") == number]
    if not shown:
        raise DataError(f"{path}: no node shows its Gaussians, expected one")
    _check_still(nodes, shown[0], path)
    return nodes[shown[0]], primitive


def _check_still(nodes: list[dict[str, Any]], shown: int, path: Path) -> None:
    """Refuse a node that moves what it shows, by itself or by one above it."""
    parents = {child: i for i, node in enumerate(nodes) for child in node.get("children", ())}
    above: set[int] = set()
    at: int | None = shown
    while at is not None and at not in above:
        if any(nodes[at].get(name, still[0]) not in still for name, still in STILL.items()):
            raise DataError(
                f"{path}: a node moves its Gaussians; write them in the frame of the world"
            )
        above.add(at)
        at = parents.get(at)
