"""From a render and its truth to numbers, by the rules of a protocol."""

import hashlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.metrics.colour_fit import fit_colours
from splatproof.metrics.pairs import check_values
from splatproof.metrics.parts import (
    OVER,
    is_part_key,
    mean_over_images,
    part_key,
    parts_of,
    score_part,
)
from splatproof.metrics.pixel import psnr_of_mse
from splatproof.metrics.registry import find_metric
from splatproof.metrics.taking import taken
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """What is scored, after the protocol's rules were applied."""

    render: Float[Tensor, "h w 3"]
    """What the method shows, clamped to [0, 1] and rounded; float32."""
    truth: Float[Tensor, "h w 3"]
    """What the camera saw, unaltered, in [0, 1]; float32."""
    mask: Bool[Tensor, "h w"] | None
    """True where a pixel counts; None: everywhere."""


def prepare(
    render: Float[Tensor, "h w 3"],
    truth: Float[Tensor, "_h _w 3"],
    protocol: Protocol,
    mask: Bool[Tensor, "_h _w"] | None = None,
    *,
    name: str = "image",
) -> Prepared:
    """Clamp and round the render, and cut render, truth and mask to the protocol's region.

    Args:
        render: Any finite values; those outside [0, 1] are clamped.
        truth: What the camera saw, in [0, 1]; never altered.
        protocol: Its rules `rounding`, `masked` and `region` are applied.
        mask: True where a pixel counts; dropped where the protocol is not masked.
        name: Name of the view, for errors.
    Raises: DataError on different sizes, pixels that are not finite, truth outside [0, 1], and
        a mask that leaves nothing.
    """
    for what, other in (("truth", truth), ("mask", mask)):
        if other is not None and other.shape[:2] != render.shape[:2]:
            raise DataError(
                f"{name}: render is {render.shape[1]} x {render.shape[0]} px but {what} is "
                f"{other.shape[1]} x {other.shape[0]} px; render at the truth's size"
            )
    used = mask if protocol.masked else None
    valid = np.ones(render.shape[:2], bool) if used is None else used.detach().cpu().numpy()
    if not valid.any():
        raise DataError(f"{name}: no valid pixel to score; check the mask and the image's size")
    check_values(render, valid, f"{name}: render", bounded=False)
    check_values(truth, valid, f"{name}: truth")
    shown = round_to_8_bit(render.detach().float().clamp(0, 1), protocol.rounding)
    part = region_columns(render.shape[1], protocol.region)
    cut = None if used is None else used[:, part]
    if part.start >= render.shape[1] or (cut is not None and not cut.any()):
        raise DataError(f"{name}: no valid pixel in the region {protocol.region!r}")
    return Prepared(render=shown[:, part], truth=truth.detach().float()[:, part], mask=cut)


def round_to_8_bit(
    image: Float[Tensor, "h w 3"], rounding: Literal["round", "truncate", "float"]
) -> Float[Tensor, "h w 3"]:
    """k / 255 with k = floor(255 x + 0.5) (round half up) or floor(255 x) (truncate).

    Args:
        image: Values in [0, 1].
        rounding: How 255 x becomes whole; "float" returns the image as it is.
    """
    if rounding == "float":
        return image
    return torch.floor(image * 255 + (0.5 if rounding == "round" else 0.0)) / 255


def region_columns(width: int, region: Literal["full", "right_half"]) -> slice:
    """The columns that are scored.

    The right half starts at ceil(width / 2) and the left one, on which appearance may be fitted,
    ends at floor(width / 2): on odd widths the middle column belongs to neither.

    Args:
        width: Width of the image in pixels.
        region: Part of the image that the protocol scores.
    """
    return slice((width + 1) // 2 if region == "right_half" else 0, width)


def score_image(
    name: str,
    render: Float[Tensor, "h w 3"],
    truth: Float[Tensor, "_h _w 3"],
    protocol: Protocol,
    mask: Bool[Tensor, "_h _w"] | None = None,
    moving: Mapping[str, Bool[Tensor, "_h _w"]] | None = None,
) -> ImageScore:
    """The protocol's metrics of one test image.

    Each colour fit of the protocol adds every metric again under its own prefix, such as
    cc_affine_psnr: the fit is made on the rounded render and its result is not rounded again.

    Args:
        name: Name of the view.
        render: What the method shows, any finite values.
        truth: What the camera saw, in [0, 1].
        protocol: Rules that say which metrics are taken, and how.
        mask: True where a pixel counts; None: everywhere.
        moving: What moves, by kind; with it the protocol's `parts` are scored too, nan for a part
            that has no pixel here. Empty: not known of this image. None: no part is scored.
    Returns: valid_share is the share of the region's pixels that were scored; truth_sha256
        hashes the region's truth, masked pixels included.
    Raises: DataError where the images cannot be scored, UsageError on an unknown metric or one of
        another's that fails, MissingError where a metric's weights are not on this machine.
    """
    ready = prepare(render, truth, protocol, mask, name=name)
    versions = {"": ready.render}
    for kind in protocol.colour_fit:
        versions[f"{kind}_"] = fit_colours(ready.render, ready.truth, ready.mask, kind)
    values = {}
    for prefix, image in versions.items():
        for metric in map(find_metric, protocol.metrics):
            value = taken(metric, image, ready.truth, ready.mask, name=name)
            values[prefix + metric.name] = value
    if moving is not None:
        part = region_columns(render.shape[1], protocol.region)
        values |= _part_values(
            ready, {kind: own[:, part] for kind, own in moving.items()}, protocol
        )
    share = 1.0 if ready.mask is None else float(ready.mask.double().mean())
    return ImageScore(
        name=name, truth_sha256=truth_sha256(ready.truth), valid_share=share, metrics=values
    )


def _part_values(
    ready: Prepared, moving: Mapping[str, Bool[Tensor, "h w"]], protocol: Protocol
) -> dict[str, float]:
    """The protocol's metrics over its parts, those that have a value at each pixel."""
    parts = parts_of(moving) if moving else {}
    return {
        part_key(part, metric): score_part(
            metric, ready.render, ready.truth, ready.mask, parts[part]
        )
        if parts
        else math.nan
        for part in protocol.parts
        for metric in protocol.metrics
        if metric in OVER
    }


def truth_sha256(truth: Float[Tensor, "h w 3"]) -> str:
    """Hash of the pixels as float32, row-major, little-endian."""
    return hashlib.sha256(truth.detach().cpu().numpy().astype("<f4").tobytes()).hexdigest()


def scene_metrics(images: Iterable[ImageScore]) -> dict[str, float]:
    """Mean over images of each metric; never the metric of pooled pixels.

    Every image weighs the same whatever its size or mask. A nan in one image makes the mean nan,
    since a mean over fewer images is another number; over a part of an image (`Protocol.parts`) the
    mean is over the images that have any of it, the same ones for every method. Beside each psnr stands what pooling would
    give: psnr_of_mean_mse = -10 log10(mean over images of 10^(-psnr / 10)).

    Args:
        images: Scores of one scene under one protocol; read once, so a generator will do.
    Raises: DataError where there is none, or where images have different metrics.
    """
    values: dict[str, list[float]] = {}
    count, first = 0, ""
    for image in images:
        if not count:
            first = image.name
            values = {key: [] for key in image.metrics}
        if image.metrics.keys() != values.keys():
            raise DataError(
                f"{image.name} has the metrics {', '.join(image.metrics)} but {first} has "
                f"{', '.join(values)}; score all images under one protocol"
            )
        count += 1
        for key, value in image.metrics.items():
            values[key].append(value)
    if not count:
        raise DataError("no image was scored, so there is no mean")
    # fsum: the mean does not depend on the order of the images
    means = {
        key: mean_over_images(own) if is_part_key(key) else math.fsum(own) / count
        for key, own in values.items()
    }
    for key, own in values.items():
        if (key == "psnr" or key.endswith("_psnr")) and not is_part_key(key):
            mse = math.fsum(10 ** (-value / 10) for value in own) / count
            means[f"{key}_of_mean_mse"] = psnr_of_mse(mse)
    return means
