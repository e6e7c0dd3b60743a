"""Adam over the tensors of a model whose rows come and go."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from splatproof.methods.kernels import adam as kernels


class Adam:
    """Adam, one learning rate a tensor; rows can be gathered and zeroed with their moments.

    Source: Kingma and Ba 2015, "Adam", Algorithm 1; betas and epsilon of the 3DGS release.
    """

    def __init__(self, parameters: Mapping[str, Tensor]) -> None:
        """Start with zero moments."""
        self.parameters = {
            name: value.detach().clone().contiguous() for name, value in parameters.items()
        }
        self.first = {name: torch.zeros_like(value) for name, value in self.parameters.items()}
        self.second = {name: torch.zeros_like(value) for name, value in self.parameters.items()}
        self.steps = 0

    def leaves(self) -> dict[str, Tensor]:
        """The parameters as fresh leaves that collect gradients."""
        return {name: value.requires_grad_() for name, value in self.parameters.items()}

    def step(self, rates: Mapping[str, float]) -> None:
        """One update with each parameter's .grad, which is cleared; without .grad nothing moves.

        Args:
            rates: Learning rate of each parameter.
        """
        self.steps += 1
        gradients = {n: v.grad for n, v in self.parameters.items() if v.grad is not None}
        kernels.step(
            [self.parameters[name].detach() for name in gradients],
            [gradient.contiguous() for gradient in gradients.values()],
            [self.first[name] for name in gradients],
            [self.second[name] for name in gradients],
            [rates[name] for name in gradients],
            self.steps,
        )
        for name in gradients:
            self.parameters[name].grad = None

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
        self.parameters[name] = value.detach().clone().contiguous()
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
