"""From a model to what is stored of it, and back: mixed precision, gated and coded harmonics."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Float16, Float32
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.reference.compression import affine_codes, spectral
from splatproof.reference.compression.affine_codes import AffineCodes, Rounding
from splatproof.reference.compression.spectral import GATE, Weighting
from splatproof.reference.types.gaussians import Gaussians


@dataclass(frozen=True, kw_only=True)
class PackSettings:
    """How much is kept of a model."""

    gate: float = GATE
    """Energy, mean size of the coefficients, below which view-dependent colour of a Gaussian is
    dropped (gamma; the paper StitchGS: 0.02); 0: all keep it."""
    weighting: Weighting = "coefficients"
    """What counts alike in that energy. coefficients: every SH coefficient; orders: every SH
    order."""
    rounding: Rounding = "nearest"
    """How view-dependent colour is rounded to 8 bits. nearest: ours; truncate: as in the
    release."""


AS_RELEASED = PackSettings(rounding="truncate")
"""The authors' code: codes are truncated at export."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PackedModel:
    """The arrays of a stored model, exactly as they are in the file."""

    means: Float32[Tensor, "n 3"]
    opacity_logits: Float16[Tensor, " n"]
    quaternions: Float16[Tensor, "n 4"]
    """(w, x, y, z), of norm 1 before they were rounded."""
    log_scales: Float16[Tensor, "n 3"]
    dc: Float16[Tensor, "n 3"]
    """SH coefficient 0 of each channel."""
    rest: AffineCodes
    """The other coefficients, coefficient-major, channel last: d = 3 ((degree + 1)^2 - 1)."""

    def __len__(self) -> int:
        """Return the number of primitives."""
        return len(self.means)


def half(name: str, values: Float[Tensor, "..."]) -> Float16[Tensor, "..."]:
    """Values in half precision.

    Args:
        name: What the values are, for errors.
        values: Numbers that are to be rounded.

    Raises: DataError where one is not finite or beyond 65504, the largest half-precision number.
    """
    short = values.half()
    if not bool(short.isfinite().all()):
        bad = values[~short.isfinite()].flatten()
        raise DataError(
            f"{name}: {len(bad)} values do not fit half precision (first: {float(bad[0]):.6g}); "
            "expected finite numbers within 65504: clean the model first"
        )
    return short


def pack(gaussians: Gaussians, settings: PackSettings) -> PackedModel:
    """Mixed-precision arrays: x float32; opacity, rotation, scale, DC float16; rest 8-bit.

    Args:
        gaussians: The model; it is left as it is.
        settings: Spectral gate, weighting of orders and rounding of codes.

    Raises: DataError for numbers that are not finite or do not fit their format.

    Source: StitchGS, Sec. 3.3.2. Logit and log scale are what is stored: ours.
    """
    means = gaussians.means.float()
    if not bool(means.isfinite().all()):
        raise DataError("positions are not all finite in float32: clean or shift the model first")
    if not bool(gaussians.sh.isfinite().all()):  # before the gate, which would hide a nan
        raise DataError("SH coefficients are not all finite: clean the model first")
    rest = spectral.gated(gaussians.sh[:, 1:], settings.gate, settings.weighting)
    return PackedModel(
        means=means,
        opacity_logits=half("opacity logit", gaussians.opacity_logits),
        quaternions=half("rotation", gaussians.unit_quaternions),
        log_scales=half("log scale", gaussians.log_scales),
        dc=half("SH DC", gaussians.sh[:, 0]),
        rest=affine_codes.encode(rest.flatten(start_dim=1), settings.rounding),
    )


def unpack(packed: PackedModel) -> Gaussians:
    """The stored model in float32, ready to render."""
    rest = affine_codes.decode(packed.rest)
    rest = rest.reshape(len(rest), rest.shape[1] // 3, 3)
    return Gaussians(
        means=packed.means,
        quaternions=packed.quaternions.float(),
        log_scales=packed.log_scales.float(),
        opacity_logits=packed.opacity_logits.float(),
        sh=torch.cat([packed.dc.float()[:, None], rest], dim=1),
    )
