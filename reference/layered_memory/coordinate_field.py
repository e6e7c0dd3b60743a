"""A small smooth field over space: multi-resolution grids, read by a two-layer network."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional


@dataclass(frozen=True, kw_only=True, eq=False)
class CoordinateField:
    """Parameters of Phi: R^3 -> R^m; every tensor is trained except the box."""

    low: Float[Tensor, "3"]
    """Corner of the box that the grids cover; outside, the border's value holds."""
    high: Float[Tensor, "3"]
    grids: tuple[Float[Tensor, "1 c _ _ _"], ...]
    """Feature grids, coarse to fine."""
    hidden: Float[Tensor, "features width"]
    hidden_bias: Float[Tensor, " width"]
    out: Float[Tensor, "width m"]
    out_bias: Float[Tensor, " m"]


def create(
    low: Float[Tensor, "3"],
    high: Float[Tensor, "3"],
    outputs: int,
    generator: torch.Generator,
    *,
    resolutions: tuple[int, ...] = (4, 8, 16, 32),
    channels: int = 4,
    width: int = 32,
) -> CoordinateField:
    """A field near zero everywhere: small random features and weights, zero output layer bias.

    Args:
        low: Lower corner of the box that the grids cover, scene units; fixes the parameters' dtype.
        high: Upper corner of the box, above `low` on every axis, scene units.
        outputs: Number m of values at a position.
        generator: Source of the random features and weights.
        resolutions: Samples on each axis of each grid, coarse to fine.
        channels: Features that each grid holds at a sample.
        width: Number of units in the network's hidden layer.

    Raises: ValueError if the box has no volume.

    Source: StratoSplat, Sec. 3.3 asks for a "compact neural field" only; the form is ours.
    """
    if not (high > low).all():
        raise ValueError(f"the box has no volume: {low.tolist()} to {high.tolist()}")

    def draw(*shape: int, spread: float) -> Tensor:
        return (torch.randn(*shape, generator=generator) * spread).to(low)

    features = channels * len(resolutions)
    return CoordinateField(
        low=low,
        high=high,
        grids=tuple(draw(1, channels, n, n, n, spread=0.1) for n in resolutions),
        hidden=draw(features, width, spread=features**-0.5),
        hidden_bias=low.new_zeros(width),
        out=draw(width, outputs, spread=0.1 * width**-0.5),
        out_bias=low.new_zeros(outputs),
    )


def evaluate(field: CoordinateField, positions: Float[Tensor, "n 3"]) -> Float[Tensor, "n m"]:
    """Values at world positions: trilinear features of all grids, then a two-layer network.

    Differentiable by the parameters and the positions.

    Args:
        field: The field's parameters.
        positions: World positions in scene units; outside the box the border's features hold.
    """
    place = 2 * (positions - field.low) / (field.high - field.low) - 1
    place = place[None, :, None, None]  # 1 n 1 1 3: a column of n samples
    features = [
        functional.grid_sample(grid, place, padding_mode="border", align_corners=True)
        for grid in field.grids
    ]
    flat = torch.cat(features, dim=1)[0, :, :, 0, 0].T
    return functional.silu(flat @ field.hidden + field.hidden_bias) @ field.out + field.out_bias
