"""In which order training looks at the views."""

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import torch


@runtime_checkable
class ViewOrder(Protocol):
    """Says which view comes next, and goes on where a killed run stopped."""

    def next(self, generator: torch.Generator) -> int:
        """Index of the next view.

        Args:
            generator: Source of every draw.
        """
        ...

    def coming(self) -> Iterator[int]:
        """Indices of the next views, as far as they are known without a draw."""
        ...

    def state(self) -> list[int]:
        """What is to be kept, JSON-ready."""
        ...

    def restore(self, state: list[int], drawn: int) -> None:
        """Go on where a run stopped.

        Args:
            state: What `state` returned then.
            drawn: Number of views that were drawn before.
        """
        ...


class Shuffled:
    """Random order without replacement, epoch after epoch."""

    def __init__(self, count: int) -> None:
        """Start before the first epoch.

        Args:
            count: Number of views.
        """
        self.count = count
        self.left: list[int] = []

    def next(self, generator: torch.Generator) -> int:
        """Index of the next view; a new epoch is shuffled when the last one is through."""
        if not self.left:
            self.left = torch.randperm(self.count, generator=generator).tolist()
        return self.left.pop()

    def coming(self) -> Iterator[int]:
        """What is left of this epoch, the next one first."""
        return reversed(self.left)

    def state(self) -> list[int]:
        """What is left of this epoch."""
        return self.left

    def restore(self, state: list[int], drawn: int) -> None:
        """Take over what was left of an epoch.

        Args:
            state: What `state` returned then.
            drawn: Not looked at.
        """
        del drawn
        self.left = list(state)


class Drawn:
    """An endless sequence of draws that depends on nothing but itself."""

    def __init__(self, draws: Iterator[int]) -> None:
        """Follow the draws."""
        self.draws = draws

    def next(self, generator: torch.Generator) -> int:
        """Index of the next view."""
        del generator
        return next(self.draws)

    def coming(self) -> Iterator[int]:
        """Nothing: a draw that was made would have to be kept."""
        return iter(())

    def state(self) -> list[int]:
        """Nothing: the draws are repeated."""
        return []

    def restore(self, state: list[int], drawn: int) -> None:
        """Skip the views that were drawn before.

        Args:
            state: Not looked at.
            drawn: Number of views that were drawn before.
        """
        del state
        for _ in range(drawn):
            next(self.draws)
