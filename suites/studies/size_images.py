"""Measured baselines of the size study: Gaussians as images, plain and with a palette of harmonics.

In the shape of PlayCanvas's SOG (version 2) and of gsplat's PNG compression, with PNG for WebP, so that
what images and palettes cost can be measured beside our file. Nothing else reads these files.
"""

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from splatproof.base.files import read_bytes
from splatproof.methods.storage.morton import morton_order
from splatproof.reference.compression.quantisers import rotation_codes, rotations
from splatproof.reference.types.gaussians import Gaussians

ROUNDS = 10
"""Lloyd's steps of k-means."""
LENGTH = struct.Struct("<I")


def write_images(path: Path, model: Gaussians, *, bits: int, palette: int = 0) -> None:
    """Write a model as PNG images of one pixel a Gaussian, row after row along the Morton curve.

    Positions: sign(p) log(1 + |p|) in 16 bits between its ends; scales, colours and opacity in 8;
    rotations as smallest three in 8; harmonics in `bits` between the ends of all.

    Args:
        path: The file: one image after another, each after its length in bytes.
        model: The Gaussians.
        bits: Bits of a coefficient of the harmonics, or of the palette's.
        palette: Entries of a palette of harmonics by k-means; 0: each Gaussian has its own.

    Source: PlayCanvas, splat-transform (SOG 2); gsplat, png_compression.
    """
    order = morton_order(model.means)
    rest = model.sh[order, 1:].flatten(start_dim=1)
    images: list[np.ndarray] = []
    facts: dict[str, Any] = {"count": len(model), "bands": model.sh.shape[1], "bits": bits}
    labels = None
    if palette and palette < len(model) and rest.shape[1]:
        rest, labels = cluster(rest, palette)
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
    if labels is not None:
        facts["palette"] = palette
        images.append(labels.numpy().astype(np.uint16)[:, None])
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
    entries = facts.get("palette", count)
    images = iter(parts[1:])
    values = []
    for (low, high), depth, width, rows in zip(
        facts["ends"], (16, 8, 8, 8, facts["bits"]), (3, 3, 3, 1, columns), [count] * 4 + [entries],
        strict=True,
    ):  # fmt: skip
        found = [_pixels(next(images), rows) for _ in range(0, width, 3)]
        codes = np.concatenate(found, axis=1) if found else np.zeros((rows, 0))
        values.append(np.array(low) + codes / (2**depth - 1) * (np.array(high) - np.array(low)))
    places, scales, dc, opacity, rest = values
    turned = _pixels(next(images), count).astype(np.int32) - 127
    if "palette" in facts:
        rest = rest[_pixels(next(images), count)[:, 0]]
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


def cluster(
    rows: Float32[Tensor, "n d"], count: int
) -> tuple[Float32[Tensor, "k d"], Int64[Tensor, " n"]]:
    """Centres of k-means and the nearest one of each row.

    Starts from evenly spaced rows, so nothing is drawn; a centre that has no rows stays.

    Args:
        rows: What is clustered, with at least `count` rows.
        count: Number of centres.

    Source: Lloyd 1982, "Least squares quantization in PCM".
    """
    centres = rows[torch.linspace(0, len(rows) - 1, count).long()].clone()
    labels = torch.zeros(len(rows), dtype=torch.int64)
    for step in range(ROUNDS + 1):
        half = centres.square().sum(dim=1) / 2
        for first in range(0, len(rows), 4096):
            part = rows[first : first + 4096]
            labels[first : first + 4096] = (half - part @ centres.T).argmin(dim=1)
        if step < ROUNDS:
            sums = torch.zeros_like(centres).index_add_(0, labels, rows)
            sizes = torch.bincount(labels, minlength=count)[:, None]
            centres = torch.where(sizes > 0, sums / sizes.clamp(min=1), centres)
    return centres, labels


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
