"""The native Adam update: all tensors of a model in one call, in place, in float32.

`step(values, gradients, first, second, rates, number, rows=None)` changes values and moments as
torch.optim.Adam does, up to rounding. The caller keeps the moments (and saves them).
"""

from collections.abc import Sequence

import torch
from jaxtyping import Bool
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.threads import use_threads

BETAS = (0.9, 0.999)
EPSILON = 1e-15


def step(
    values: Sequence[Tensor],
    gradients: Sequence[Tensor],
    first: Sequence[Tensor],
    second: Sequence[Tensor],
    rates: Sequence[float],
    number: int,
    *,
    rows: Bool[Tensor, " n"] | None = None,
    betas: tuple[float, float] = BETAS,
    epsilon: float = EPSILON,
) -> None:
    """One Adam update: m += (1 - b1)(g - m), v += (1 - b2)(g^2 - v), x -= r m' / (sqrt(v') + e).

    Args:
        values: Parameters, changed in place.
        gradients: Gradient g of the loss by each parameter, of its shape.
        first: First moments m, changed in place; zero before the first update.
        second: Second moments v, changed in place; zero before the first update.
        rates: Learning rate r of each tensor.
        number: 1 for the first update; m' and v' are the moments without their bias towards zero.
        rows: Rows to update in every tensor, all of which then have n rows; the others keep value
            and moments. None: all.
        betas: Decay b1 and b2 of the moments, each in [0, 1).
        epsilon: Number e that is added to the root, > 0.

    Raises: ValueError if a tensor is not float32, contiguous and on the CPU, or shapes differ.

    Source: Kingma and Ba 2015, "Adam", Algorithm 1; epsilon of the 3DGS release; rows: ours.
    """
    if number < 1:
        raise ValueError(f"number is {number}, expected at least 1")
    groups = {"values": values, "gradients": gradients, "first": first, "second": second}
    for name, tensors in groups.items():
        if len(tensors) != len(rates):
            raise ValueError(f"{name} has {len(tensors)} tensors, expected {len(rates)} as rates")
        for i, (tensor, value) in enumerate(zip(tensors, values, strict=True)):
            good = tensor.dtype == torch.float32 and tensor.is_contiguous() and tensor.is_cpu
            if not good or tensor.shape != value.shape:
                raise ValueError(
                    f"{name}[{i}] is {tensor.dtype} {tuple(tensor.shape)} on {tensor.device}, "
                    f"expected contiguous torch.float32 {tuple(value.shape)} on the CPU"
                )
    use_threads()
    at = {name: [tensor.data_ptr() for tensor in tensors] for name, tensors in groups.items()}
    _ext.adam(
        at["values"], at["gradients"], at["first"], at["second"],
        [len(value) if value.ndim else 0 for value in values], [value.numel() for value in values],
        list(rates), number, betas[0], betas[1], epsilon, rows,
    )  # fmt: skip
