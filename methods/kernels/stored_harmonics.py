"""The native view-dependent colour as our small file gives it back, in float32.

It agrees with splatproof.reference.compression.quantisers (harmonic_codes, then harmonics) up to rounding; numbers
half-way between two codes may go either way.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof import _ext
from splatproof.reference.compression.quantisers import Steps


def stored_harmonics(
    rest: Float[Tensor, "n r 3"],
    log_scales: Float[Tensor, "n 3"],
    logits: Float[Tensor, " n"],
    steps: Steps,
) -> Float[Tensor, "n r 3"]:
    """View-dependent colour on the steps of each Gaussian's class, with the gradient of the values themselves.

    Args:
        rest: SH coefficients without DC.
        log_scales: Logarithms of scales; their nearest codes count.
        logits: Opacity logits; their nearest codes count.
        steps: The file's.

    Raises: ValueError unless everything is float32 on the CPU, and the shapes fit together.

    Source: quantisers (reference.compression); gradients: Bengio et al. 2013, "Estimating or propagating
        gradients through stochastic neurons", Sec. 4 (straight-through estimator).
    """
    if any(t.dtype != torch.float32 or t.device.type != "cpu" for t in (rest, log_scales, logits)):
        raise ValueError("expected torch.float32 on the CPU")
    return _Stored.apply(rest, log_scales, logits, steps)


class _Stored(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rest: Tensor, log_scales: Tensor, logits: Tensor, steps: Steps):
        del ctx
        of = tuple(values.detach().contiguous() for values in (rest, log_scales, logits))
        stored = torch.empty_like(of[0])
        weights = torch.tensor(steps.weights, dtype=torch.int64)
        sizes = (steps.log_scale, steps.opacity, steps.harmonics)
        _ext.store_harmonics(of[0], of[1], of[2], *sizes, weights, stored)
        return stored

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        # the change of channels is orthonormal: gradients of codes come back as those of values
        del ctx
        return grad_outputs[0], None, None, None
