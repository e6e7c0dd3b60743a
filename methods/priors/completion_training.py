"""Points as matched photos leave them, drawn from true depth: what the completion network is trained with."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt
from torch import Tensor
from torch.nn import functional

from splatproof.methods.priors.network import DepthNetwork
from splatproof.methods.priors.network_training import Sample, affine_loss

WITHOUT_POINTS = 0.1
"""Share of samples without any point: a photo that nothing was matched with."""
SHARES = (0.003, 0.25)
"""Share of the pixels that have a point where photos were matched, log-uniform between these."""
PATCHES = (4, 5)
"""Rows and columns of the noise whose heights say where photos were matched: whole regions are, and others not."""
LEAST_REGION = 0.1
"""Least share of a photo where photos were matched; up to all of it, uniform."""
NOISE = 0.005
"""Standard deviation of a point's disparity, as a share of it."""
WRONG, OFF = 0.02, (0.7, 1.4)
"""Share of points that are wrong matches, and between what their disparity is multiplied."""


def matched_points(
    given: Float[Tensor, "n 5 h w"],
    truth: Float[Tensor, "n h w"],
    known: Bool[Tensor, "n h w"],
    draw: torch.Generator,
) -> None:
    """Put points in the last two channels: dense in some regions, none in others, a few of them wrong.

    Args:
        given: What the network sees; its last two channels are written.
        truth: True disparity; 0 in the sky.
        known: Pixels that have one.
        draw: Source of places and errors.

    Source: ours.
    """
    count, (height, width) = len(given), given.shape[2:]
    patches = torch.randn(count, 1, *PATCHES, generator=draw)
    heights = functional.interpolate(patches, (height, width), mode="bicubic")[:, 0].flatten(1)
    region = LEAST_REGION + (1 - LEAST_REGION) * torch.rand(count, generator=draw)
    region[torch.rand(count, generator=draw) < WITHOUT_POINTS] = 0
    ranks = heights.argsort(dim=1).argsort(dim=1).view(count, height, width)
    matched = ranks < (region * height * width)[:, None, None]
    low, high = torch.tensor(SHARES).log()
    share = (low + (high - low) * torch.rand(count, 1, 1, generator=draw)).exp()
    mask = matched & known & (truth > 0)  # nothing is matched in the sky
    mask &= torch.rand(count, height, width, generator=draw) < share
    wrong = torch.rand(count, height, width, generator=draw) < WRONG
    off = OFF[0] + (OFF[1] - OFF[0]) * torch.rand(count, height, width, generator=draw)
    near = 1 + NOISE * torch.randn(count, height, width, generator=draw)
    disparity = truth * torch.where(wrong, off, near)
    for index in range(count):
        seen = disparity[index][mask[index]]
        unit = seen.median() if len(seen) else 1.0
        given[index, 3] = torch.where(mask[index], disparity[index] / unit, 0)
    given[:, 4] = mask.to(given)


def errors(network: DepthNetwork, samples: Sequence[Sample]) -> dict[str, float]:
    """Mean `affine_loss` of what the network says of views, and of the nearest point's disparity.

    Args:
        network: Its weights.
        samples: Views that it was not trained on; each is given points of its own draw.

    Returns: `own` and `nearest`; a constant, which is what no point leaves to the nearest, has 1.
    """
    draw = torch.Generator().manual_seed(0)
    found: dict[str, list[float]] = {"own": [], "nearest": []}
    for sample in samples:
        given, truth, known = sample.given[None].clone(), sample.truth[None], sample.known[None]
        matched_points(given, truth, known, draw)
        with torch.inference_mode():
            said = network(given)
        for name, disparity in (("own", said), ("nearest", _nearest(given)[None])):
            found[name].append(float(affine_loss(disparity, truth, known)))
    return {name: sum(values) / len(values) for name, values in found.items()}


def _nearest(given: Float[Tensor, "1 5 h w"]) -> Float[Tensor, "h w"]:
    """The disparity of each pixel's nearest point; 0 without any."""
    sparse, mask = given[0, 3], given[0, 4] > 0
    if not bool(mask.any()):
        return torch.zeros_like(sparse)
    places = distance_transform_edt((~mask).numpy(), return_distances=False, return_indices=True)
    rows, columns = torch.from_numpy(np.asarray(places)).long()
    return sparse[rows, columns]
