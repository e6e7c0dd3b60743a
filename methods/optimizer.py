"""Adam over the tensors of a model whose rows come and go."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Int
from torch import Tensor

BETAS = (0.9, 0.999)
EPSILON = 1e-15


class Adam:
    """Adam, one learning rate a tensor; rows can be gathered and zeroed with their moments.

    Source: Kingma and Ba 2015, "Adam", Algorithm 1; epsilon of the 3DGS release.
    """

    def __init__(self, parameters: Mapping[str, Tensor]) -> None:
        """Start with zero moments."""
        self.parameters = {name: value.detach().clone() for name, value in parameters.items()}
        self.first = {name: torch.zeros_like(value) for name, value in self.parameters.items()}
        self.second = {name: torch.zeros_like(value) for name, value in self.parameters.items()}
        self.steps = 0

    def leaves(self) -> dict[str, Tensor]:
        """The parameters as fresh leaves that collect gradients."""
        return {name: value.requires_grad_() for name, value in self.parameters.items()}

    @torch.no_grad()
    def step(self, rates: Mapping[str, float]) -> None:
        """One update with each parameter's .grad, which is cleared; without .grad nothing moves.

        Args:
            rates: Learning rate of each parameter.
        """
        self.steps += 1
        first_part = 1 - BETAS[0] ** self.steps
        second_part = 1 - BETAS[1] ** self.steps
        for name, value in self.parameters.items():
            if value.grad is None:
                continue
            first, second = self.first[name], self.second[name]
            first.lerp_(value.grad, 1 - BETAS[0])
            second.mul_(BETAS[1]).addcmul_(value.grad, value.grad, value=1 - BETAS[1])
            spread = (second.sqrt() / second_part**0.5).add_(EPSILON)
            value.addcdiv_(first, spread, value=-rates[name] / first_part)
            value.grad = None

    @torch.no_grad()
    def gather(self, parents: Int[Tensor, " m"], fresh: Bool[Tensor, " m"]) -> None:
        """Row i becomes old row parents[i]; moments come along, or are zero where fresh[i]."""
        for name, value in self.parameters.items():
            self.parameters[name] = value.detach()[parents]
            for moments in (self.first, self.second):
                moments[name] = moments[name][parents]
                moments[name][fresh] = 0

    @torch.no_grad()
    def overwrite(self, name: str, value: Tensor, *, forget: bool) -> None:
        """Replace a parameter's values.

        Args:
            name: Which parameter.
            value: Of the same shape.
            forget: Whether its moments start again at zero.
        """
        self.parameters[name] = value.detach().clone()
        if forget:
            self.first[name].zero_()
            self.second[name].zero_()

    def state(self) -> dict[str, Tensor]:
        """Everything that the next step depends on, as named tensors."""
        groups = {"value": self.parameters, "first": self.first, "second": self.second}
        state = {
            f"{group}.{name}": tensor.detach()
            for group, tensors in groups.items()
            for name, tensor in tensors.items()
        }
        return state | {"steps": torch.tensor(self.steps)}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take over what `state` returned."""
        for name in self.parameters:
            self.parameters[name] = state[f"value.{name}"].clone()
            self.first[name] = state[f"first.{name}"].clone()
            self.second[name] = state[f"second.{name}"].clone()
        self.steps = int(state["steps"])
