"""Gaussians as .sog: PlayCanvas' Spatially Ordered Gaussians, version 2, images and a palette of harmonics."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor

from splatproof.base.errors import DataError, UsageError
from splatproof.methods.models.explicit import check_gaussians
from splatproof.methods.storage.morton import morton_order
from splatproof.methods.storage.sog_bundle import (
    META,
    MOST_SIDE,
    Bundle,
    Picture,
    opened,
    sides,
    webp,
    write_bundle,
)
from splatproof.methods.storage.sog_clusters import LEVELS, clustered, codebook, labels_of
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians

VERSION = 2
MOST_ENTRIES = 2**16
"""Entries of a palette at the most: a label is two bytes."""
IN_A_ROW = 64
"""Entries of the palette in a row of its image."""
FIRST_TAG = 252
"""Alpha of a rotation whose largest component is w; x, y and z follow."""
MOST_CODE = 2**16 - 1
"""Highest code of a position."""
FARTHEST = math.log1p(float(np.finfo(np.float32).max))
"""sign(p) log(1 + |p|) of the farthest position that float32 holds."""
BARELY = 1e-6
"""Opacities that are stored as 0 and 1 come back so far from them, where their logits are finite."""
COLUMNS = {"means": 2, "quats": 1, "scales": 1, "sh0": 1}
"""Parts of meta.json that every file has, and how many images each."""


def write_sog(
    path: str | Path, gaussians: Gaussians, mode: Mode = "classic", *, palette: int | None = None
) -> None:
    """Write positions in 16 bits, rotations, opacities, scales and colours in 8, harmonics as entries of a palette.

    Gaussians lie in the order of the Morton curve. Positions are stored as sign(p) log(1 + |p|) between the ends of
    all: a step of x is 1 / 65,535 of what lies between them, times 1 + |x|. Scales, colours and the palette's
    coefficients are labels of 256 levels each that k-means finds. All codes are the nearest; what `at_the_ends`
    counts is stored as an opacity of 0 or 1. The same model gives the same bytes.

    Args:
        path: The file, written whole or not at all.
        gaussians: The model, in float32.
        mode: How the model is rasterized; the file says where that is antialiased.
        palette: Entries of the palette of harmonics, 1 to 65,536; no more than there are Gaussians are written. None: as
            many as the format's own encoder takes (`usual_entries`).

    Raises: DataError for no Gaussians, for numbers that are not finite and for more Gaussians than an image of 16,383 pixels
        a side holds; UsageError for another number of entries.

    Source: the format's public description and its encoder's number of entries (PlayCanvas, SOG version 2).
    """
    path = Path(path)
    if not len(gaussians):
        raise DataError(f"{path}: 0 Gaussians. Expected at least one")
    check_gaussians(gaussians, path)
    if palette is not None and not 1 <= palette <= MOST_ENTRIES:
        raise UsageError(f"palette {palette}: .sog holds 1 to {MOST_ENTRIES} entries")
    width, height = sides(len(gaussians))
    if max(width, height) > MOST_SIDE:
        raise DataError(
            f"{path}: {len(gaussians)} Gaussians; a .sog holds images of {MOST_SIDE} pixels a side, write a .ply"
        )
    order = morton_order(gaussians.means)
    gaussians = Gaussians(**{name: values[order] for name, values in vars(gaussians).items()})
    facts, images = _columns(gaussians)
    meta: dict[str, Any] = {"version": VERSION, "asset": {"generator": "splatproof"},
                            "count": len(gaussians), "antialias": mode == "antialiased"} | facts  # fmt: skip
    members = {name: webp(values, width, height) for name, values in images.items()}
    if gaussians.degree:
        entries = palette or usual_entries(len(gaussians))
        meta["shN"], values, labels = _palette(gaussians, entries)
        shape = IN_A_ROW * (gaussians.sh.shape[1] - 1), -(-meta["shN"]["count"] // IN_A_ROW)
        members |= {"shN_centroids.webp": webp(values, *shape),
                    "shN_labels.webp": webp(labels, width, height)}  # fmt: skip
    write_bundle(path, meta, members)


def usual_entries(count: int) -> int:
    """Entries of the palette that the format's own encoder takes: the power of two below, 65,536 at the most.

    Args:
        count: Number of Gaussians, at least 1.

    Source: the encoder's public source (PlayCanvas, splat-transform): min(64, 2^floor(log2(n / 1024))) * 1024.
    """
    return min(MOST_ENTRIES, 1 << (count.bit_length() - 1))


def at_the_ends(gaussians: Gaussians) -> dict[str, int]:
    """Gaussians whose opacity a .sog stores as 0, which viewers leave out, or as 1.

    Args:
        gaussians: The model that is written.
    Returns: "0" and "1", those alone that are there.
    """
    codes = _opacities(gaussians)
    found = {"0": int((codes == 0).sum()), "1": int((codes == 255).sum())}
    return {name: count for name, count in found.items() if count}


def _opacities(gaussians: Gaussians) -> UInt8[np.ndarray, " n"]:
    """Codes of opacities."""
    return np.rint(gaussians.opacities.double().numpy() * 255).astype(np.uint8)


def _columns(
    gaussians: Gaussians,
) -> tuple[dict[str, dict[str, Any]], dict[str, UInt8[np.ndarray, "n _"]]]:
    """What meta.json says of all but harmonics, and the columns of their images."""
    means = gaussians.means.double().numpy()
    places = np.sign(means) * np.log1p(np.abs(means))
    low, high = places.min(axis=0), places.max(axis=0)
    reach = np.where(high > low, high - low, 1)
    codes = np.rint((places - low) / reach * MOST_CODE).astype(np.uint16)
    scales, dc = gaussians.log_scales.numpy(), gaussians.sh[:, 0].numpy()
    levels = {"scales": codebook(scales), "sh0": codebook(dc)}
    images = {
        "means_l.webp": (codes & 255).astype(np.uint8), "means_u.webp": (codes >> 8).astype(np.uint8),
        "quats.webp": _turned(gaussians), "scales.webp": labels_of(scales, levels["scales"]),
        "sh0.webp": np.column_stack([labels_of(dc, levels["sh0"]), _opacities(gaussians)]),
    }  # fmt: skip
    return {
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": _text(levels["scales"]), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": _text(levels["sh0"]), "files": ["sh0.webp"]},
    }, images  # fmt: skip


def _turned(gaussians: Gaussians) -> UInt8[np.ndarray, "n 4"]:
    """Codes of the three components of each unit quaternion that are not the largest, and which that is."""
    unit = gaussians.unit_quaternions.double().numpy()
    largest = np.abs(unit).argmax(axis=1)
    rows = np.arange(len(unit))
    unit *= np.where(unit[rows, largest] < 0, -1.0, 1.0)[:, None]
    others = unit[rows[:, None], OTHERS[largest]]
    codes = np.rint((others * math.sqrt(2) + 1) / 2 * 255).clip(0, 255)
    return np.column_stack([codes, FIRST_TAG + largest]).astype(np.uint8)


OTHERS = np.array([[other for other in range(4) if other != one] for one in range(4)])
"""Components beside each, in order."""


def _palette(
    gaussians: Gaussians, entries: int
) -> tuple[dict[str, Any], UInt8[np.ndarray, "p 3"], UInt8[np.ndarray, "n 3"]]:
    """What meta.json says of the harmonics, labels of each entry's coefficients, and the entry of each Gaussian."""
    rest = gaussians.sh[:, 1:]
    found, labels = clustered(rest.flatten(start_dim=1), entries)
    values = found.reshape(len(found) * rest.shape[1], 3).numpy()
    levels = codebook(values)
    words = labels.numpy()
    told = {"count": len(found), "bands": gaussians.degree, "codebook": _text(levels),
            "files": ["shN_centroids.webp", "shN_labels.webp"]}  # fmt: skip
    return (
        told,
        labels_of(values, levels),
        np.column_stack([words & 255, words >> 8, 0 * words]).astype(np.uint8),
    )


def _text(levels: Float32[np.ndarray, "256"]) -> list[float]:
    """Levels as numbers of few digits that float32 reads as they were."""
    return [float(str(level)) for level in levels]


def read_sog(path: str | Path) -> tuple[Gaussians, Mode]:
    """The Gaussians of a .sog file of version 2, and how they are rasterized.

    Opacities that are stored as 0 and 1 come back as 1e-6 and 1 - 1e-6. What meta.json and the images say of their
    sizes is checked before anything is decoded.

    Args:
        path: A bundle, by this project or another tool, with lossless WebP images.
    Returns: The Gaussians in float32, in the order of the file, and "antialiased" where it says so, else "classic".
    Raises: DataError, in one line, naming the file and the fault; MissingError where memory is short.

    Source: the format's public description (PlayCanvas, SOG version 2).
    """
    path = Path(path)
    with opened(path) as bundle:
        meta = bundle.meta()
        if meta.get("version") != VERSION:
            raise DataError(
                f"{path}: version {meta.get('version')!r} of SOG, expected {VERSION}; write it again with a newer tool"
            )
        count, mode = _whole(path, "count", meta["count"], None), meta.get("antialias", False)
        pictures = _pictures(bundle, meta, count)
        bands = _whole(path, "shN.bands", meta["shN"]["bands"], 3) if "shN" in meta else 0
        rest = (bands + 1) ** 2 - 1
        entries = 0
        if bands:
            entries = _whole(path, "shN.count", meta["shN"]["count"], MOST_ENTRIES)
            one = pictures["shN 0"]
            if one.width != IN_A_ROW * rest or one.height * IN_A_ROW < entries:
                raise DataError(f"{path}: {one.name} is {one.width} x {one.height} pixels, expected {IN_A_ROW * rest} "
                                f"x {-(-entries // IN_A_ROW)} for {entries} entries")  # fmt: skip
        bundle.check(pictures, count * (14 + 3 * rest) + 3 * rest * entries)
        model = Gaussians(
            means=_means(path, meta["means"], pictures, count),
            quaternions=_quaternions(path, pictures["quats 0"].pixels()[:count]),
            log_scales=torch.from_numpy(
                _levels(path, "scales", meta)[pictures["scales 0"].pixels()[:count, :3]]
            ),
            **_colours(path, meta, pictures, count, entries, rest),
        )
    check_gaussians(model, path)
    return model, "antialiased" if mode is True else "classic"


def _whole(path: Path, name: str, value: object, most: int | None) -> int:
    """A number of things out of meta.json."""
    if type(value) is not int or value < 1 or (most is not None and value > most):
        ends = "of 1 or more" if most is None else f"from 1 to {most}"
        raise DataError(f"{path}: {META} says {name} {value!r}, expected a whole number {ends}")
    return value


def _pictures(bundle: Bundle, meta: dict[str, Any], count: int) -> dict[str, Picture]:
    """All images, none decoded, those of one pixel a Gaussian large enough: "means 0" is the first of means."""
    found = {}
    for part, files in (COLUMNS | ({"shN": 2} if "shN" in meta else {})).items():
        names = meta[part]["files"]
        if not isinstance(names, list) or len(names) != files:
            raise DataError(f"{bundle.path}: {META} says {part}.files {names!r}, expected {files}")
        for number, name in enumerate(names):
            one = found[f"{part} {number}"] = bundle.picture(name)
            if (part, number) != ("shN", 0) and one.width * one.height < count:
                raise DataError(f"{bundle.path}: {one.name} is {one.width} x {one.height} pixels, expected at least "
                                f"{count}, one for each Gaussian")  # fmt: skip
    return found


def _numbers(path: Path, name: str, values: object, length: int) -> Float[np.ndarray, " n"]:
    """Finite numbers out of meta.json, in float64."""
    if not isinstance(values, list) or len(values) != length:
        size = f"{len(values)} values" if isinstance(values, list) else repr(values)
        raise DataError(f"{path}: {META} says {size} of {name}, expected {length} numbers")
    wrong = [
        value for value in values if type(value) not in (int, float) or not abs(value) < 2.0**128
    ]
    if wrong:
        raise DataError(
            f"{path}: {META} says {wrong[0]!r} in {name}, expected a finite number of float32"
        )
    return np.array(values, dtype=np.float64)


def _levels(path: Path, part: str, meta: dict[str, Any]) -> Float32[np.ndarray, "256"]:
    """A codebook out of meta.json."""
    return _numbers(path, f"{part}.codebook", meta[part]["codebook"], LEVELS).astype(np.float32)


def _means(
    path: Path, told: dict[str, Any], pictures: dict[str, Picture], count: int
) -> Float32[Tensor, "n 3"]:
    """Positions."""
    low, high = (_numbers(path, f"means.{end}", told[end], 3) for end in ("mins", "maxs"))
    if max(np.abs(low).max(), np.abs(high).max()) > FARTHEST:
        raise DataError(f"{path}: {META} says means from {low.tolist()} to {high.tolist()}, expected logarithms up to "
                        f"{FARTHEST:.6g}")  # fmt: skip
    below, above = (pictures[f"means {half}"].pixels()[:count, :3] for half in (0, 1))
    means = np.empty((count, 3), dtype=np.float32)
    for axis in range(3):  # one after another: float64 takes room
        codes = below[:, axis] + above[:, axis] * 256.0
        place = low[axis] + codes / MOST_CODE * (high[axis] - low[axis])
        means[:, axis] = np.sign(place) * np.expm1(np.abs(place))
    return torch.from_numpy(means)


def _quaternions(path: Path, codes: UInt8[np.ndarray, "n 4"]) -> Float32[Tensor, "n 4"]:
    """Rotations of their codes: the largest component is the root of what the squares of the others leave of 1."""
    wrong = np.flatnonzero(codes[:, 3] < FIRST_TAG)
    if len(wrong):
        raise DataError(f"{path}: rotation of Gaussian {wrong[0]} says {codes[wrong[0], 3]} in alpha, expected "
                        f"{FIRST_TAG} to 255")  # fmt: skip
    largest, rows = codes[:, 3] - FIRST_TAG, np.arange(len(codes))
    others = (codes[:, :3] / np.float32(255) * 2 - 1) / np.float32(math.sqrt(2))
    found = np.empty((len(codes), 4), dtype=np.float32)
    found[rows[:, None], OTHERS[largest]] = others
    found[rows, largest] = np.sqrt(np.maximum(0, 1 - np.square(others).sum(axis=1)))
    return torch.from_numpy(found)


def _colours(
    path: Path,
    meta: dict[str, Any],
    pictures: dict[str, Picture],
    count: int,
    entries: int,
    rest: int,
) -> dict[str, Tensor]:
    """Opacity logits and harmonics."""
    codes = pictures["sh0 0"].pixels()[:count]
    opacity = (codes[:, 3] / 255).clip(BARELY, 1 - BARELY)
    sh = np.empty((count, 1 + rest, 3), dtype=np.float32)
    sh[:, 0] = _levels(path, "sh0", meta)[codes[:, :3]]
    if rest:
        words = pictures["shN 1"].pixels()[:count].astype(np.int32)
        labels = words[:, 0] + 256 * words[:, 1]
        if labels.max() >= entries:
            worst = int(labels.argmax())
            raise DataError(
                f"{path}: harmonics of Gaussian {worst} are entry {labels[worst]} of a palette of {entries}"
            )
        shown = pictures["shN 0"].pixels()[: -(-entries // IN_A_ROW) * IN_A_ROW * rest, :3]
        sh[:, 1:] = _levels(path, "shN", meta)[shown].reshape(-1, rest, 3)[labels]
    logits = np.log(opacity / (1 - opacity)).astype(np.float32)
    return {"opacity_logits": torch.from_numpy(logits), "sh": torch.from_numpy(sh)}
