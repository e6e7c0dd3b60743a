"""Metric brightness_bias: how much brighter a render is than the truth, on average."""

from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.metrics.pairs import check_pair
from splatproof.metrics.registry import Metric


def brightness_bias(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """Size of the mean signed difference over valid pixels and channels.

    Args:
        image: What is scored, in [0, 1].
        target: The truth, in [0, 1].
        mask: True where a pixel counts.
    """
    pair = check_pair(image, target, mask, metric="brightness_bias")
    return abs(float((pair.image - pair.target)[pair.valid].mean()))


METRIC = Metric(
    name="brightness_bias", function=brightness_bias, unit="", higher_is_better=False,
    range=(0.0, 1.0), source="this example",
)  # fmt: skip
