"""A measured baseline of the size study: Gaussians as PNG images, one pixel each.

In the shape of gsplat's PNG compression, so that what images cost can be measured beside our file. Nothing else reads
these files.
"""

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from splatproof.base.files import read_bytes
from splatproof.methods.storage.morton import morton_order
from splatproof.reference.compression.quantisers import rotation_codes, rotations
from splatproof.reference.types.gaussians import Gaussians

LENGTH = struct.Struct("<I")


def write_images(path: Path, model: Gaussians, *, bits: int) -> None:
    """Write a model as PNG images of one pixel a Gaussian, row after row along the Morton curve.

    Positions: sign(p) log(1 + |p|) in 16 bits between its ends; scales, colours and opacity in 8;
    rotations as smallest three in 8; harmonics in `bits` between the ends of all.

    Args:
        path: The file: one image after another, each after its length in bytes.
        model: The Gaussians.
        bits: Bits of a coefficient of the harmonics.

    Source: gsplat, png_compression; the Morton curve for its sorting.
    """
    order = morton_order(model.means)
    rest = model.sh[order, 1:].flatten(start_dim=1)
    images: list[np.ndarray] = []
    facts: dict[str, Any] = {"count": len(model), "bands": model.sh.shape[1], "bits": bits}
    means = model.means[order].double()
    ends = []
    for values, depth, together in (
        (means.sign() * means.abs().log1p(), 16, False), (model.log_scales[order], 8, False),
        (model.sh[order, 0], 8, False), (model.opacity_logits[order, None].sigmoid(), 8, False),
        (rest, bits, True),
    ):  # fmt: skip
        codes, low, high = _levels(values.double().numpy(), depth, together)
        ends.append((low, high))
        images += [codes[:, first : first + 3] for first in range(0, codes.shape[1], 3)]
    turned = rotation_codes(model.quaternions[order].double().numpy(), 8)
    images.append((turned + 127).astype(np.uint8))
    facts["ends"] = ends
    parts = [json.dumps(facts).encode(), *(_png(image) for image in images)]
    path.write_bytes(b"".join(LENGTH.pack(len(part)) + part for part in parts))


def read_images(path: Path) -> Gaussians:
    """The Gaussians of write_images, in the order of the file.

    Args:
        path: The file.
    """
    data, parts, at = read_bytes(path), [], 0
    while at < len(data):
        (length,) = LENGTH.unpack_from(data, at)
        parts.append(data[at + 4 : at + 4 + length])
        at += 4 + length
    facts = json.loads(parts[0])
    count, columns = facts["count"], 3 * (facts["bands"] - 1)
    images = iter(parts[1:])
    values = []
    for (low, high), depth, width in zip(
        facts["ends"], (16, 8, 8, 8, facts["bits"]), (3, 3, 3, 1, columns), strict=True
    ):
        found = [_pixels(next(images), count) for _ in range(0, width, 3)]
        codes = np.concatenate(found, axis=1) if found else np.zeros((count, 0))
        values.append(np.array(low) + codes / (2**depth - 1) * (np.array(high) - np.array(low)))
    places, scales, dc, opacity, rest = values
    turned = _pixels(next(images), count).astype(np.int32) - 127
    sh = np.concatenate([dc[:, None], rest.reshape(count, -1, 3)], axis=1)
    alpha = opacity[:, 0].clip(0.5 / 255, 1 - 0.5 / 255)
    arrays = (np.sign(places) * np.expm1(np.abs(places)), rotations(turned, 8), scales,
              np.log(alpha / (1 - alpha)), sh)  # fmt: skip
    means, quaternions, log_scales, logits, sh = (
        torch.from_numpy(a.astype(np.float32)) for a in arrays
    )
    return Gaussians(
        means=means, quaternions=quaternions, log_scales=log_scales, opacity_logits=logits, sh=sh
    )


def _levels(
    values: np.ndarray, bits: int, together: bool
) -> tuple[np.ndarray, list[float], list[float]]:
    """Whole numbers from 0 to 2^bits - 1 between the ends of each column, or of all."""
    axis = None if together else 0
    low, high = values.min(axis=axis, initial=np.inf), values.max(axis=axis, initial=-np.inf)
    if not values.size:
        low, high = np.zeros(()), np.zeros(())
    reach = np.where(high > low, high - low, 1)
    kind = np.uint16 if bits > 8 else np.uint8
    codes = np.rint((values - low) / reach * (2**bits - 1)).astype(kind)
    return codes, np.atleast_1d(low).tolist(), np.atleast_1d(high).tolist()


def _png(columns: np.ndarray) -> bytes:
    """An image, about as high as wide, of one or three columns."""
    count, channels = columns.shape
    width = max(1, int(np.ceil(np.sqrt(count))))
    height = max(1, -(-count // width))
    image = np.zeros((height * width, channels), dtype=columns.dtype)
    image[:count] = columns
    good, data = cv2.imencode(
        ".png", image.reshape(height, width, channels), [cv2.IMWRITE_PNG_COMPRESSION, 9]
    )
    assert good
    return data.tobytes()


def _pixels(data: bytes, count: int) -> np.ndarray:
    """The columns of an image."""
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image.reshape(image.shape[0] * image.shape[1], -1)[:count]
