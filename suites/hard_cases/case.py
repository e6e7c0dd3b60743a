"""A hard case: where its numbers come from, what runs on them, what must come out."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class HardCase:
    """One difficult input of one component.

    A "finite" case is run in float64, the truth, and in float32: both must be finite and close. A
    "refused" case must raise ValueError or a one-line error of ours, never pass or crash.
    """

    component: str
    name: str
    inputs: Callable[[], tuple[Tensor, ...]]
    """Makes the inputs in float64; the same numbers every time."""
    run: Callable[..., Tensor]
    """The component on those inputs, everything of interest in one tensor."""
    expect: Literal["finite", "refused"] = "finite"
    budget: float = 1e-4
    """Largest |float32 - float64| / max(1, largest |float64|); the measured value is in the row."""
    differentiable: bool = False
    """Also compare the gradients by the inputs."""


def fixed(*values: Tensor) -> Callable[[], tuple[Tensor, ...]]:
    """Inputs that are written out, in float64."""
    return lambda: tuple(value.double() for value in values)


def drawn(seed: int, *shapes: tuple[int, ...]) -> Callable[[], tuple[Tensor, ...]]:
    """Normal random inputs of the given shapes.

    Args:
        seed: Seed of the draw.
        shapes: Shape of each input.
    """

    def make() -> tuple[Tensor, ...]:
        generator = torch.Generator().manual_seed(seed)
        return tuple(
            torch.randn(shape, generator=generator, dtype=torch.float64) for shape in shapes
        )

    return make


def joined(*parts: Tensor) -> Tensor:
    """Several outputs as one flat tensor."""
    return torch.cat([part.reshape(-1) for part in parts])
