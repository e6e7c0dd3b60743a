"""Scores over the part of an image that some training photo can have shown."""

import math
from dataclasses import replace

from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.parts import OVER, SEEN, SEEN_SHARE, part_key, score_part
from splatproof.metrics.scoring import prepare, region_columns
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore


def with_seen(
    score: ImageScore,
    render: Float[Tensor, "h w 3"],
    truth: Float[Tensor, "_h _w 3"],
    protocol: Protocol,
    mask: Bool[Tensor, "_h _w"] | None,
    seen: Bool[Tensor, "_h _w"] | None,
    *,
    apart: bool,
) -> ImageScore:
    """An image's score with what it has on the seen part: seen_share, seen_psnr, ...

    Args:
        score: The score of the whole image.
        render: What the method shows, as it was scored.
        truth: What the camera saw.
        protocol: Its rules and metrics; those with a value at each pixel are scored.
        mask: True where a pixel counts; None: everywhere.
        seen: True where a training photo can have shown the pixel; None: not known of this image.
        apart: Whether the part is scored too, or its share alone is given: where every image of the
            scene is seen whole the scores would be those of the whole image.
    Returns: seen_share is the share of the scored pixels; all are nan where `seen` is None, and the
        scores where nothing is seen.
    Source: ours.
    """
    ready = prepare(render, truth, protocol, mask, name=score.name)
    names = [name for name in protocol.metrics if apart and name in OVER]
    share, values = math.nan, dict.fromkeys(names, math.nan)
    if seen is not None:
        part = seen[:, region_columns(seen.shape[1], protocol.region)]
        counted = part if ready.mask is None else part[ready.mask]
        share = float(counted.double().mean())
        values = {
            name: score.metrics[name]
            if share == 1
            else score_part(name, ready.render, ready.truth, ready.mask, part)
            for name in names
        }
    keyed = {part_key(SEEN, name): value for name, value in values.items()}
    return replace(score, metrics=score.metrics | {SEEN_SHARE: share} | keyed)
