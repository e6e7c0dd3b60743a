"""Trained tensors as a small file will give them back, with gradients that pass through the rounding."""

from collections.abc import Mapping

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatproof.methods.kernels import stored_harmonics as native
from splatproof.reference.compression.quantisers import (
    FRACTION,
    MOST_CELL,
    MOST_LOGIT,
    OPPONENT,
    WIDEST,
    Steps,
)

LEAST = 1e-12
"""Least length of a quaternion that is divided by."""


def stored(rows: Mapping[str, Tensor], steps: Steps) -> dict[str, Tensor]:
    """The tensors on the file's steps; each passes gradients on as if nothing were rounded.

    Classes are those of the rounded scales and opacities, as a reader finds them. What leaves the grid of positions is
    seen on its edge, where the file can hold it. Rotations are those of
    the nearest codes whose w is not negative, so a model should have come from the file once: its
    largest component is w then, and the file's own choice of half turn is this one.

    Args:
        rows: Tensors means, quaternions, log_scales, opacity_logits, sh_dc and sh_rest.
        steps: The file's.

    Source: quantisers (reference.compression); gradients: Bengio et al. 2013, "Estimating or
        propagating gradients through stochastic neurons", Sec. 4 (straight-through estimator).
    """
    log_scales = rounded(rows["log_scales"], steps.log_scale)
    logits = rounded(rows["opacity_logits"].clamp(-MOST_LOGIT, MOST_LOGIT), steps.opacity)
    edge = MOST_CELL * steps.position
    rest = stored_harmonics(rows["sh_rest"], log_scales, logits, steps)
    found = dict(rows)
    found |= {
        "means": rounded(rows["means"].clamp(-edge, edge), steps.position),
        "log_scales": log_scales,
        "opacity_logits": logits,
        "quaternions": _turned(rows["quaternions"], steps.rotation_bits),
        "sh_dc": rounded(rows["sh_dc"], steps.dc),
        "sh_rest": rest,
    }
    return found


def stored_harmonics(
    rest: Float[Tensor, "n r 3"],
    log_scales: Float[Tensor, "n 3"],
    logits: Float[Tensor, " n"],
    steps: Steps,
) -> Float[Tensor, "n r 3"]:
    """View-dependent colour on the steps of each Gaussian's class, with the gradient of the values themselves.

    By the kernel where it can.

    Args:
        rest: SH coefficients without DC.
        log_scales: Logarithms of scales, on their steps.
        logits: Opacity logits, on their steps.
        steps: The file's.
    """
    if rest.device.type == "cpu" and rest.dtype == torch.float32:
        return native.stored_harmonics(rest, log_scales, logits, steps)
    return stored_harmonics_torch(rest, log_scales, logits, steps)


def stored_harmonics_torch(
    rest: Float[Tensor, "n r 3"],
    log_scales: Float[Tensor, "n 3"],
    logits: Float[Tensor, " n"],
    steps: Steps,
) -> Float[Tensor, "n r 3"]:
    """The same on any device and in any precision.

    Args:
        rest: SH coefficients without DC.
        log_scales: Logarithms of scales, on their steps.
        logits: Opacity logits, on their steps.
        steps: The file's.

    Source: see `stored`; OPPONENT is orthonormal, so gradients come back as they were.
    """
    step = harmonic_steps(log_scales, logits, steps)
    opponent = torch.from_numpy(OPPONENT).to(rest)
    channels = rest @ opponent.T
    codes = (channels.detach() / step).round() * step
    return (channels + (codes - channels).detach()) @ opponent


def rounded(values: Float[Tensor, "*shape"], step: float) -> Float[Tensor, "*shape"]:
    """Multiples of a step, with the gradient of the values themselves.

    Args:
        values: What is rounded.
        step: Distance of two multiples, > 0.

    Source: Bengio et al. 2013, see `stored`.
    """
    nearest = ((values.detach().double() / step).round() * step).to(values)
    return values + (nearest - values).detach()


def harmonic_steps(
    log_scales: Float[Tensor, "n 3"], logits: Float[Tensor, " n"], steps: Steps
) -> Float[Tensor, "n 1 1"]:
    """Step of each Gaussian's harmonics, of its class (quantisers.classes).

    Args:
        log_scales: Logarithms of scales, on their steps.
        logits: Opacity logits, on their steps.
        steps: The file's.
    """
    s = _codes(log_scales, steps.log_scale).sort(dim=1).values
    a = _codes(logits, steps.opacity)
    facts = (torch.ones_like(a), a, a * a, *s.unbind(dim=1))
    parts = [k * fact for k, fact in zip(steps.weights, facts, strict=True)]
    total = torch.stack(parts).sum(dim=0)
    shift = ((total + (1 << FRACTION - 1)) >> FRACTION).clamp(-WIDEST, WIDEST)
    return (steps.harmonics * torch.exp2(shift.double())).to(log_scales)[:, None, None]


def rate(rows: Mapping[str, Tensor], steps: Steps) -> Float[Tensor, ""]:
    """About the bits a Gaussian that its harmonics take: the mean sum of log2(1 + |x| / step).

    Args:
        rows: Tensors log_scales, opacity_logits and sh_rest; the last gets a gradient.
        steps: The file's.

    Source: ours; a smooth stand-in for the length of an adaptive code, of the right slope far from 0.
    """
    log_scales = rounded(rows["log_scales"].detach(), steps.log_scale)
    logits = rounded(rows["opacity_logits"].detach().clamp(-MOST_LOGIT, MOST_LOGIT), steps.opacity)
    channels = rows["sh_rest"] @ torch.from_numpy(OPPONENT).to(rows["sh_rest"]).T
    sizes = channels.abs() / harmonic_steps(log_scales, logits, steps)
    return torch.log2(1 + sizes).sum() / max(len(sizes), 1)


def _codes(values: Float[Tensor, "*shape"], step: float) -> Int64[Tensor, "*shape"]:
    return (values.detach().double() / step).round().long()


def _turned(quaternions: Float[Tensor, "n 4"], bits: int) -> Float[Tensor, "n 4"]:
    """Unit quaternions of the nearest codes."""
    unit = quaternions / quaternions.norm(dim=1, keepdim=True).clamp(min=LEAST)
    unit = unit * torch.where(unit[:, :1] < 0, -1.0, 1.0)
    half = (1 << (bits - 1)) - 1
    scale = half * 2.0**0.5
    xyz = ((unit[:, 1:].detach() * scale).round().clamp(-half, half)) / scale
    w = (1 - xyz.square().sum(dim=1, keepdim=True)).clamp(min=0).sqrt()
    return unit + (torch.cat([w, xyz], dim=1) - unit).detach()
