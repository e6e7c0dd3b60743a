"""From numbers of Gaussians to integer codes and back: steps, and what decides a step.

Everything a reader computes is integer, or one IEEE operation after another in float64, so that every
machine finds the same. Codes are a fixed point: quantising what was restored gives them again.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64

from splatproof.base.errors import DataError

MOST_CELL = 2**20 - 1
"""Size of a cell number along an axis, counted from the origin of the frame, at the most: float32
holds each cell, and three differences fill a place on the Morton curve."""
MOST_CODE = 2**15
"""Size of a code of a scale, an opacity or a colour, at the most."""
MOST_LOGIT = 12.0
"""Opacity logits beyond are stored as this: opacities within 6e-6 of 0 and of 1."""
OPPONENT = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [1.0, -2.0, 1.0]]) / np.sqrt(
    [[3.0], [2.0], [6.0]]
)
"""Rows: brightness, red against blue, green against both; orthonormal."""
WIDEST = 3
"""Steps of harmonics are 2^-3 to 2^3 times the base: seven classes."""
FRACTION = 16
"""Bits behind the point of the coefficients that decide a class."""


@dataclass(frozen=True, kw_only=True)
class Steps:
    """How finely a model is stored."""

    position: float
    """Side of a cell, in units of the frame, > 0."""
    log_scale: float
    """Step of the natural logarithm of a scale, > 0."""
    opacity: float
    """Step of the opacity logit, > 0."""
    rotation_bits: int
    """Bits of each of a rotation's three stored components, 4 (below, rounding can leave no room for
    the fourth) to 12."""
    dc: float
    """Step of SH coefficient 0, > 0."""
    harmonics: float
    """Step of the other SH coefficients in class 3, > 0."""
    weights: tuple[int, ...]
    """Six coefficients in 2^-16 of the class, see `classes`; sizes up to 2^26."""


def cells(means: Float64[np.ndarray, "n 3"], step: float) -> Int64[np.ndarray, "n 3"]:
    """Cell of each position on the cubic grid: round(x / step).

    Args:
        means: Positions, finite.
        step: Side of a cell.

    Raises: DataError for positions beyond the grid's 2^20 - 1 cells to either side.

    Source: ours.
    """
    found = np.rint(means / step)
    if len(found) and not np.abs(found).max() <= MOST_CELL:
        raise DataError(
            f"positions up to {np.abs(means).max():.6g} with a step of {step:.3g}: expected at most "
            f"{MOST_CELL} steps; take a larger step, or shift or clean the model"
        )
    return found.astype(np.int64)


def uniform(
    name: str, values: Float64[np.ndarray, "*shape"], step: float
) -> Int32[np.ndarray, "*shape"]:
    """Codes round(x / step): off by at most step / 2.

    Args:
        name: What the values are, for errors.
        values: Numbers that are to be stored.
        step: Distance of two codes' values.

    Raises: DataError for numbers that are not finite or beyond 2^15 steps.

    Source: ours.
    """
    found = np.rint(values / step)
    if found.size and not np.abs(found).max() <= MOST_CODE:
        bad = values[~(np.abs(found) <= MOST_CODE)].flat[0]
        raise DataError(
            f"{name}: {bad:.6g} is not finite or beyond {MOST_CODE * step:.6g}, the last step of the "
            "grid: clean the model first"
        )
    return found.astype(np.int32)


def rotation_codes(quaternions: Float64[np.ndarray, "n 4"], bits: int) -> Int32[np.ndarray, "n 3"]:
    """Codes of (x, y, z) of the half turn of each rotation whose w is largest.

    A half turn about an axis of an ellipsoid leaves it as it is, so the largest component of the
    unit quaternion (w, x, y, z) can be moved to w and needs no index; the others lie within
    +-1/sqrt(2), which 2^bits - 1 steps fill. Quaternions on the grid keep their codes: turning them
    by rounding's luck would not be a fixed point.

    Args:
        quaternions: Rotations of any length; 0 counts as none.
        bits: Bits of each component, 4 to 12.

    Raises: DataError for numbers that are not finite.

    Source: smallest three: Niantic Labs' spz, version 3; half turns: ours.
    """
    if not np.isfinite(quaternions).all():
        raise DataError("rotation: not all finite: clean the model first")
    size = np.linalg.norm(quaternions, axis=1, keepdims=True)
    unit = np.where(size > 0, quaternions / np.where(size > 0, size, 1), [1.0, 0.0, 0.0, 0.0])
    half = (1 << (bits - 1)) - 1
    scale = half * math.sqrt(2.0)
    kept = np.rint(unit[:, 1:] * scale)
    fits = (np.abs(unit[:, 1:] * scale - kept) < 1e-3).all(axis=1) & (unit[:, 0] >= 0)
    fits &= (np.abs(kept) <= half).all(axis=1)
    w, x, y, z = unit.T
    turned = np.stack(
        [[w, x, y, z], [x, -w, -z, y], [y, z, -w, -x], [z, -y, x, -w]]
    )  # times -1, i, j or k, up to the sign that does not turn
    best = turned[np.abs(unit).argmax(axis=1), :, np.arange(len(unit))]
    best *= np.where(best[:, :1] < 0, -1.0, 1.0)
    codes = np.where(fits[:, None], kept, np.rint(best[:, 1:] * scale))
    return codes.clip(-half, half).astype(np.int32)


def rotations(codes: Int32[np.ndarray, "n 3"], bits: int) -> Float64[np.ndarray, "n 4"]:
    """Unit quaternions (w, x, y, z) of codes: w = sqrt(max(0, 1 - x^2 - y^2 - z^2)).

    Args:
        codes: What rotation_codes returned.
        bits: Bits of each component.

    Source: ours, see rotation_codes.
    """
    x, y, z = (codes / (((1 << (bits - 1)) - 1) * math.sqrt(2.0))).T
    return np.stack([np.sqrt(np.maximum(0, 1 - x * x - y * y - z * z)), x, y, z], axis=1)


def colour_difference(codes: Int32[np.ndarray, "n 3"]) -> Int32[np.ndarray, "n 3"]:
    """YCoCg-R of integer (r, g, b): lossless brightness and two differences.

    Co = r - b, t = b + (Co >> 1), Cg = g - t, Y = t + (Cg >> 1).

    Source: Malvar and Sullivan 2003, "YCoCg-R: a color space with RGB reversibility".
    """
    r, g, b = codes.T
    co = r - b
    t = b + (co >> 1)
    cg = g - t
    return np.stack([t + (cg >> 1), co, cg], axis=1)


def colour(codes: Int32[np.ndarray, "n 3"]) -> Int32[np.ndarray, "n 3"]:
    """The integers that colour_difference was given.

    Source: Malvar and Sullivan 2003, see colour_difference.
    """
    y, co, cg = codes.T
    t = y - (cg >> 1)
    b = t - (co >> 1)
    return np.stack([b + co, cg + t, b], axis=1)


def classes(
    log_scales: Int32[np.ndarray, "n 3"], opacity: Int32[np.ndarray, " n"], weights: tuple[int, ...]
) -> Int32[np.ndarray, " n"]:
    """Class 0 to 6 of each Gaussian's step of harmonics: base 2^(class - 3).

    A Gaussian's error of colour reaches the images with an energy W_2, the sum over pixels and views
    of its squared blending weight, so equal cost asks for steps that grow as W_2^(-1/2). That is
    predicted from codes that the reader has: with a the opacity's, s_1 <= s_2 <= s_3 the scales',

        class = 3 + clip(round(k_0 + k_1 a + k_2 a^2 + k_3 s_1 + k_4 s_2 + k_5 s_3), -3, 3)

    in integers, the coefficients k in 2^-16, halves rounded up.

    Args:
        log_scales: Codes of the logarithms of the scales.
        opacity: Codes of the opacity logits.
        weights: k.

    Source: ours.
    """
    rounded = (weighed(log_scales, opacity, weights) + (1 << FRACTION - 1)) >> FRACTION
    return (rounded.clip(-WIDEST, WIDEST) + WIDEST).astype(np.int32)


def weighed(
    log_scales: Int32[np.ndarray, "n 3"], opacity: Int32[np.ndarray, " n"], weights: tuple[int, ...]
) -> Int64[np.ndarray, " n"]:
    """The sum that decides a class, before it is rounded, in 2^-16.

    Args:
        log_scales: Codes of the logarithms of the scales.
        opacity: Codes of the opacity logits.
        weights: k of `classes`.

    Source: ours.
    """
    a, s = opacity.astype(np.int64), np.sort(log_scales.astype(np.int64), axis=1)
    facts = (1, a, a * a, s[:, 0], s[:, 1], s[:, 2])
    total = np.zeros(len(a), dtype=np.int64)
    for weight, fact in zip(weights, facts, strict=True):
        total += weight * fact
    return total


def harmonic_codes(
    rest: Float64[np.ndarray, "n k 3"], found: Int32[np.ndarray, " n"], base: float
) -> Int32[np.ndarray, "3*k n"]:
    """Codes round(x / step) of the opponent channels x of each coefficient: off by half a step.

    A dead zone, in which more becomes 0, was measured and costs more than larger steps do.

    Args:
        rest: SH coefficients from 1 on, finite, channel last.
        found: Class of each Gaussian's step from `classes`.
        base: Step of class 3.

    Returns: A row for each coefficient and in it each channel.

    Raises: DataError for numbers that are not finite or beyond 2^15 steps.

    Source: ours.
    """
    if not np.isfinite(rest).all():
        raise DataError("SH: not all finite: clean the model first")
    r, g, b = np.moveaxis(rest, 2, 0)
    channels = np.stack([row[0] * r + row[1] * g + row[2] * b for row in OPPONENT], axis=2)
    steps = np.ldexp(base, found - WIDEST)[:, None, None]
    codes = uniform("SH", channels / steps, 1.0)
    return np.ascontiguousarray(codes.reshape(len(rest), 3 * rest.shape[1]).T)


def harmonics(
    codes: Int32[np.ndarray, "d n"], found: Int32[np.ndarray, " n"], base: float
) -> Float32[np.ndarray, "n k 3"]:
    """SH coefficients of codes: each code times its step, back from opponent channels.

    Args:
        codes: What harmonic_codes returned.
        found: Class of each Gaussian's step from `classes`.
        base: Step of class 3.

    Source: ours.
    """
    step = np.ldexp(base, found - WIDEST)
    y, u, v = (codes[channel::3] * step for channel in range(3))
    colours = [OPPONENT[0, c] * y + OPPONENT[1, c] * u + OPPONENT[2, c] * v for c in range(3)]
    return np.stack(colours, axis=2).swapaxes(0, 1).astype(np.float32)
