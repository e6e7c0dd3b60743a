"""What decides which rows a model has: the contract of density control, and what it is told."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.reference.types.camera import Camera

Statistic = Literal["signed", "absolute"]
"""Gradients by the 2D means: their sum over pixels, or the sum of their absolute values."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """What one rendered view of a step says about the splats; valid until the next view."""

    camera: Camera
    radii: Float[Tensor, " n"]
    """Longer half-extent in pixels; 0 where a splat was not seen."""
    opacities: Float[Tensor, " n"] | None
    """Opacities of the splats; None where the kernels drew raw rows."""
    signed: Float[Tensor, "n 2"] | None
    """Sum over pixels of d loss / d (2D mean), per pixel; None where not asked for."""
    absolute: Float[Tensor, "n 2"] | None
    """Sum over pixels of |d loss / d (2D mean)|; None where not asked for."""
    rows: Int[Tensor, " n"] | None
    """Row that each splat was decoded from, -1: none; None: splat i is row i."""
    slots: Int[Tensor, " n"] | None
    """Place among the decoded splats: row * k + place; None: not told apart."""
    decoded: Int[Tensor, " v"] | None = None
    """Rows that were decoded for the view, whether they show a splat or not; None: all were."""
    count: int
    """Number of rows of the model."""

    def by_row(self, values: Float[Tensor, " n"]) -> Float[Tensor, " m"]:
        """Sum of a number a splat over the splats of each row; virtual splats are left out.

        Args:
            values: One number a splat.
        """
        if self.rows is None:
            return values
        # a virtual splat adds 0 to row 0: far cheaper than picking the others
        real = values.where(self.rows >= 0, 0)
        return values.new_zeros(self.count).index_add_(0, self.rows.clamp(min=0), real)

    def gradient_norm(self, statistic: Statistic) -> Float[Tensor, " n"]:
        """Norm of a splat's gradient by its 2D mean, in units of half the image.

        Args:
            statistic: Which gradient; it must have been asked for.
        """
        gradient = self.signed if statistic == "signed" else self.absolute
        assert gradient is not None, f"statistic {statistic!r} was not asked for"
        half = gradient.new_tensor([self.camera.width / 2, self.camera.height / 2])
        return (gradient * half).norm(dim=1)


@runtime_checkable
class DensityStrategy(Protocol):
    """Decides, while training goes on, which rows stay, are copied, split, made or removed."""

    needs: frozenset[Statistic]
    """Which gradients by the 2D means it is to be told."""

    def watches(self, step: int) -> bool:
        """Whether the views of a step are to be observed.

        Args:
            step: Number of the step, from 1.
        """
        ...

    def observe(self, seen: Observation) -> None:
        """Take note of one view.

        Args:
            seen: What the view says; valid during this call only.
        """
        ...

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Changes at the end of a step, each made before the next is asked for.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors as they are now.
            generator: Source of every draw.
        """
        ...

    def state(self) -> dict[str, Tensor]:
        """Everything that later edits depend on, as named tensors."""
        ...

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` returned."""
        ...


class Frozen:
    """The rows stay as they are."""

    needs: frozenset[Statistic] = frozenset()

    def watches(self, step: int) -> bool:
        """Never."""
        del step
        return False

    def observe(self, seen: Observation) -> None:
        """Nothing is noted."""
        del seen

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """No edits, ever.

        Args:
            step: Not looked at.
            parameters: Not looked at.
            generator: Not drawn from.
        """
        del step, parameters, generator
        return iter(())

    def state(self) -> dict[str, Tensor]:
        """Nothing is to be kept."""
        return {}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Nothing was kept."""
        del state
