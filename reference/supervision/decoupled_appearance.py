"""Decoupled appearance: a network says of each photo what it did to the colours, and is dropped after training."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.reference.supervision.losses import photometric

EMBEDDING = 64
"""Numbers of a photo's embedding."""
SPREAD = 1e-4
"""Deviation of embeddings at the start."""
SHRINK = 32
"""Times that the render is shrunk before the network reads it."""
WIDTHS = (256, 128, 64, 32, 16)
"""Channels after the first layer and after each that doubles the size."""

Network = dict[str, Float[Tensor, "..."]]
"""Weights and biases of convolutions over 3 x 3 pixels by name: first, up0 to up3, wide, last."""


def drawn_network(generator: torch.Generator) -> Network:
    """A network that changes no colour yet: its last layer is 0, the others are drawn.

    Args:
        generator: Source of the draw, uniform within the root of 1 / inputs of a pixel.
    """
    inner = {f"up{i}": (WIDTHS[i] // 4, WIDTHS[i + 1]) for i in range(len(WIDTHS) - 1)}
    sizes = {"first": (3 + EMBEDDING, WIDTHS[0]), **inner, "wide": (WIDTHS[-1], WIDTHS[-1])}
    network: Network = {}
    for name, (inputs, outputs) in sizes.items():
        bound = 1 / math.sqrt(9 * inputs)
        for part, shape in (("weight", (outputs, inputs, 3, 3)), ("bias", (outputs,))):
            network[f"{name}.{part}"] = bound * (2 * torch.rand(*shape, generator=generator) - 1)
    network["last.weight"] = torch.zeros(3, WIDTHS[-1], 3, 3)
    network["last.bias"] = torch.zeros(3)
    return network


def colour_map(
    network: Network, image: Float[Tensor, "h w 3"], embedding: Float[Tensor, " e"]
) -> Float[Tensor, "h w 3"]:
    """What a photo did to the colours, as a factor of each, in (0, 2).

    The render, shrunk 32 times, and the photo's embedding at each of its pixels; a convolution; four times
    twice the size (pixel shuffle, convolution); the size of the image; two convolutions.

    Args:
        network: From `drawn_network`.
        image: The render, of any size.
        embedding: The photo's.

    Source: Lin et al. 2024, "VastGaussian", Sec. 4.2, Fig. 4; twice a sigmoid, so that 0 is no change, is ours (others
        have a sigmoid alone, which darkens).
    """

    def layer(name: str, values: Tensor) -> Tensor:
        return functional.conv2d(
            values, network[f"{name}.weight"], network[f"{name}.bias"], padding=1
        )

    size = image.shape[:2]
    small = [math.ceil(side / SHRINK) for side in size]
    planes = _resized(image.permute(2, 0, 1)[None], small)
    told = embedding[None, :, None, None].expand(1, -1, *small)
    values = layer("first", torch.cat([planes, told], dim=1)).relu()
    for i in range(len(WIDTHS) - 1):
        values = layer(f"up{i}", functional.pixel_shuffle(values, 2)).relu()
    values = layer("wide", _resized(values, list(size))).relu()
    return 2 * torch.sigmoid(layer("last", values)[0].permute(1, 2, 0))


def decoupled_loss(
    image: Float[Tensor, "h w 3"],
    factors: Float[Tensor, "h w 3"],
    photo: Float[Tensor, "h w 3"],
    *,
    dssim: float = 0.2,
    mask: Bool[Tensor, "h w"] | None = None,
) -> Float[Tensor, ""]:
    """(1 - l) L1 of the render in the photo's appearance, and l (1 - SSIM) of the render itself.

    Args:
        image: The render.
        factors: From `colour_map`.
        photo: In [0, 1].
        dssim: l, in [0, 1].
        mask: Pixels that count; None: all.

    Source: Lin et al. 2024, "VastGaussian", Eq. 5.
    """
    colours = photometric(image * factors, photo, dssim=0.0, mask=mask)
    structure = photometric(image, photo, dssim=1.0, mask=mask)
    return (1 - dssim) * colours + dssim * structure


def _resized(values: Float[Tensor, "1 c h w"], size: list[int]) -> Float[Tensor, "1 c i j"]:
    return functional.interpolate(values, size=size, mode="bilinear", align_corners=True)
