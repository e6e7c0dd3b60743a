"""Small networks as shared tensors of a model: one tensor a weight matrix or bias, by name."""

from collections.abc import Mapping

from torch import Tensor

from splatproof.reference.types.mlp import Mlp


def named(networks: Mapping[str, Mlp]) -> dict[str, Tensor]:
    """The tensors `network.weight0`, `network.bias0`, `network.weight1`, ...

    Args:
        networks: Networks by their names.
    """
    return {
        f"{name}.{part}{layer}": value
        for name, network in networks.items()
        for part, values in (("weight", network.weights), ("bias", network.biases))
        for layer, value in enumerate(values)
    }


def network(name: str, tensors: Mapping[str, Tensor]) -> Mlp:
    """The network of that name; the same tensors, so gradients reach them.

    Args:
        name: Name of the network.
        tensors: As `named` names them; others are passed over.

    Raises: KeyError if there is no such network.
    """
    layers = sum(each.startswith(f"{name}.weight") for each in tensors)
    if layers == 0:
        raise KeyError(f"{name}.weight0")
    return Mlp(
        weights=tuple(tensors[f"{name}.weight{i}"] for i in range(layers)),
        biases=tuple(tensors[f"{name}.bias{i}"] for i in range(layers)),
    )
