"""Hard cases that grow harder rung by rung: a component of the reference in float32 against float64."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from splatproof.suites.hard_cases.case import HardCase


def same(rung: float) -> float:
    """The budget as it is, at any rung.

    Args:
        rung: How difficult.
    """
    del rung
    return 1.0


def tenth(rung: float) -> float:
    """A budget that grows with the rung from 10 on: what is rounded is shown so many times as large.

    Args:
        rung: How difficult.
    """
    return max(1.0, rung / 10)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rising:
    """One difficulty of one component, that a number says."""

    component: str
    name: str
    """What the number is, for people."""
    inputs: Callable[[float], tuple[Tensor, ...]]
    """Inputs at a rung in float64; the same numbers every time."""
    run: Callable[..., Tensor]
    """run(rung, *inputs): the component, everything of interest in one tensor."""
    rungs: tuple[float, ...] = (1.0, 1e2, 1e4, 1e6)
    """The numbers, hardest last."""
    budget: float = 2e-6
    """Largest |float32 - float64| / max(1, largest |float64|) of the first rung. Most of them have 1e-7, a
    rounding or two; a sum of a picture's pixels up to 9e-7."""
    more: Callable[[float], float] = same
    """Times the budget that a rung may be off."""
    reason: str = ""
    """Why it may be off by more, and what was measured."""
    differentiable: bool = False

    def at(self, rung: float) -> HardCase:
        """The case of one rung.

        Args:
            rung: How difficult.
        """
        return HardCase(
            component=self.component, name=f"{self.name} {rung:g}", inputs=lambda: self.inputs(rung),
            run=lambda *inputs: self.run(rung, *inputs), budget=self.budget * self.more(rung),
            differentiable=self.differentiable,
        )  # fmt: skip


def generator(seed: int = 0) -> torch.Generator:
    """A source of numbers that starts the same every time.

    Args:
        seed: Its seed.
    """
    return torch.Generator().manual_seed(seed)


def normal(*shape: int, seed: int = 0) -> Tensor:
    """Normal numbers in float64.

    Args:
        shape: How many on each axis.
        seed: Seed of the draw.
    """
    return torch.randn(*shape, generator=generator(seed), dtype=torch.float64)


def uniform(*shape: int, seed: int = 0) -> Tensor:
    """Numbers in [0, 1) in float64.

    Args:
        shape: How many on each axis.
        seed: Seed of the draw.
    """
    return torch.rand(*shape, generator=generator(seed), dtype=torch.float64)
