"""How parameters follow their gradients: Adam or momentum, one rate a tensor, rows that come and go."""

from collections.abc import Mapping

import torch
from torch import Tensor

from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.kernels import adam as kernels

MOMENTUM = 0.9
"""Momentum of plain gradient descent, as in the release of StitchGS."""


class Adam:
    """Adam, one learning rate a tensor; an edit of rows takes their moments along.

    Source: Kingma and Ba 2015, "Adam", Algorithm 1; betas and epsilon of the 3DGS release.
    """

    def __init__(self, parameters: Parameters) -> None:
        """Start with zero moments."""
        self.parameters = parameters
        self.first = {n: torch.zeros_like(value) for n, value in parameters.trained.items()}
        self.second = {n: torch.zeros_like(value) for n, value in parameters.trained.items()}
        self.steps = 0

    def step(self, rates: Mapping[str, float]) -> None:
        """One update with each tensor's .grad, which is cleared; without .grad nothing moves.

        Args:
            rates: Learning rate of each tensor that has a gradient.
        """
        self.steps += 1
        moved = {n: v for n, v in self.parameters.trained.items() if v.grad is not None}
        self._move(moved, [rates[name] for name in moved])
        for value in moved.values():
            value.grad = None

    def _move(self, moved: Mapping[str, Tensor], rates: list[float]) -> None:
        names = list(moved)
        values = [moved[name].detach() for name in names]
        gradients = [moved[name].grad for name in names]
        update = kernels.step if all(v.device.type == "cpu" for v in values) else adam_by_torch
        update(
            values, [g.contiguous() for g in gradients if g is not None],
            [self.first[name] for name in names], [self.second[name] for name in names],
            rates, self.steps,
        )  # fmt: skip

    @torch.no_grad()
    def edit(self, edit: Edit) -> None:
        """Take the moments of the rows along; those of fresh rows and forgotten tensors are zero.

        Args:
            edit: How the rows of the parameters changed.
        """
        for moments in (self.first, self.second):
            for name in self.parameters.rows:
                if edit.parents is not None:
                    moments[name] = moments[name][edit.parents]
                    if edit.fresh is not None:
                        moments[name][edit.fresh] = 0
                if name in edit.forget:
                    moments[name].zero_()

    def restart(self) -> None:
        """Forget all moments, as before the first update."""
        for moments in (self.first, self.second):
            for value in moments.values():
                value.zero_()
        self.steps = 0

    def state(self) -> dict[str, Tensor]:
        """Everything beside the parameters that the next step depends on, as named tensors."""
        groups = {"first": self.first, "second": self.second}
        state = {
            f"{group}.{name}": tensor
            for group, tensors in groups.items()
            for name, tensor in tensors.items()
        }
        return state | {"steps": torch.tensor(self.steps)}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take over what `state` returned."""
        for name, value in self.parameters.trained.items():
            self.first[name] = state[f"first.{name}"].clone().to(value.device)
            self.second[name] = state[f"second.{name}"].clone().to(value.device)
        self.steps = int(state["steps"])


class Momentum(Adam):
    """Gradient descent with momentum: m = 0.9 m + g, x -= rate m.

    Source: the release of StitchGS (torch's SGD with momentum 0.9).
    """

    def _move(self, moved: Mapping[str, Tensor], rates: list[float]) -> None:
        for (name, value), rate in zip(moved.items(), rates, strict=True):
            assert value.grad is not None
            self.first[name].mul_(MOMENTUM).add_(value.grad)
            value.detach().sub_(rate * self.first[name])


@torch.no_grad()
def adam_by_torch(
    values: list[Tensor],
    gradients: list[Tensor],
    first: list[Tensor],
    second: list[Tensor],
    rates: list[float],
    number: int,
) -> None:
    """Twin of kernels.adam.step for other devices than the CPU, up to rounding.

    Args:
        values: Parameters, changed in place.
        gradients: Gradient of the loss by each of them.
        first: First moments, changed in place; zero before the first update.
        second: Second moments, changed in place; zero before the first update.
        rates: Learning rate of each tensor.
        number: Number of the update, 1 for the first.
    """
    (beta1, beta2), bias = kernels.BETAS, [1 - beta**number for beta in kernels.BETAS]
    for value, gradient, m, v, rate in zip(values, gradients, first, second, rates, strict=True):
        m.lerp_(gradient, 1 - beta1)
        v.lerp_(gradient.square(), 1 - beta2)
        value.sub_(rate * (m / bias[0]) / ((v / bias[1]).sqrt() + kernels.EPSILON))


class GradientMean:
    """Several views, one step: collects the gradients of one backward pass after the other."""

    def __init__(self) -> None:
        """Start with no pass."""
        self._sums: dict[str, Tensor] = {}
        self._passes = 0

    def take(self, parameters: Mapping[str, Tensor]) -> None:
        """Move the .grad of the parameters into the sum; a parameter without one adds zero.

        Args:
            parameters: Trained tensors by name, after a backward pass.
        """
        self._passes += 1
        for name, value in parameters.items():
            if value.grad is not None:
                held = self._sums.get(name)
                self._sums[name] = value.grad.clone() if held is None else held.add_(value.grad)
                value.grad = None

    def leave(self, parameters: Mapping[str, Tensor]) -> None:
        """Leave the mean over the passes as the parameters' .grad.

        Args:
            parameters: Trained tensors by name.
        """
        for name, total in self._sums.items():
            parameters[name].grad = total.div_(self._passes)
