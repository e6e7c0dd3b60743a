"""Small fully connected networks as plain data and a function."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Mlp:
    """Weights and biases, first layer first; ReLU between layers, nothing after the last."""

    weights: tuple[Float[Tensor, "_ _"], ...]
    """Weight matrix of each layer, of shape (inputs, outputs)."""
    biases: tuple[Float[Tensor, " _"], ...]


def create(
    sizes: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype = torch.float32
) -> Mlp:
    """A network with He-initialised weights and zero biases.

    Args:
        sizes: Inputs, hidden widths, outputs; at least two numbers.
        generator: Source of the random weights, which are drawn in torch's default dtype.
        dtype: Dtype of the parameters.

    Source: He et al. 2015, "Delving Deep into Rectifiers", Eq. 10.
    """
    pairs = list(itertools.pairwise(sizes))
    return Mlp(
        weights=tuple(
            (torch.randn(a, b, generator=generator) * (2 / max(1, a)) ** 0.5).to(dtype)
            for a, b in pairs
        ),
        biases=tuple(torch.zeros(b, dtype=dtype) for _, b in pairs),
    )


def evaluate(network: Mlp, inputs: Float[Tensor, "n a"]) -> Float[Tensor, "n b"]:
    """Outputs of the network.

    Args:
        network: Layers to apply, first to last, with ReLU between them.
        inputs: One row a sample, as many columns as the first layer has inputs.
    """
    values = inputs
    for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        values = values @ weight + bias
        if layer + 1 < len(network.weights):
            values = values.relu()
    return values


def change(network: Mlp, function: Callable[[Tensor], Tensor]) -> Mlp:
    """The network with a function applied to every parameter (to zero, freeze or copy it).

    Args:
        network: The network to start from; it is left as it is.
        function: Takes one weight matrix or bias vector and returns what stands in its place.
    """
    return Mlp(
        weights=tuple(function(weight) for weight in network.weights),
        biases=tuple(function(bias) for bias in network.biases),
    )
