"""Two images and a mask, checked once before any metric looks at them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """An image, its target and the pixels that count."""

    image: Float[np.ndarray, "h w 3"]
    """Float64 in [0, 1]; 0 where a pixel does not count, so that its content cannot matter."""
    target: Float[np.ndarray, "h w 3"]
    """Float64 in [0, 1]; 0 where a pixel does not count."""
    valid: Bool[np.ndarray, "h w"]
    """True where a pixel counts."""


def check_pair(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
    *,
    window: int = 1,
    metric: str = "metric",
) -> Pair:
    """The two images as float64 with everything blanked that the mask leaves out.

    Args:
        image: What is scored, sRGB in [0, 1].
        target: The truth, sRGB in [0, 1].
        mask: True where a pixel counts; None: everywhere.
        window: Side of the square window that the metric needs to fit, in pixels.
        metric: Name of the metric, for errors.
    Raises: DataError on sizes that differ, an image without pixels or smaller than the window,
        and valid pixels that are not finite or outside [0, 1] (says where).
    """
    size = image.shape[:2]
    for what, other in (("target", target), ("mask", mask)):
        if other is not None and other.shape[:2] != size:
            raise DataError(
                f"{metric}: image is {_size(size)} but {what} is {_size(other.shape)}; "
                "both must have the same size"
            )
    if min(size) < window:
        raise DataError(
            f"{metric}: image is {_size(size)}, smaller than the metric's "
            f"{window} x {window} px window; score larger images or leave {metric} out"
        )
    valid = np.ones(size, dtype=bool) if mask is None else mask.detach().cpu().numpy()
    check_values(image, valid, f"{metric}: image")
    check_values(target, valid, f"{metric}: target")
    return Pair(image=_blanked(image, valid), target=_blanked(target, valid), valid=valid)


def check_values(
    image: Float[Tensor, "h w 3"],
    valid: Bool[np.ndarray, "h w"],
    what: str,
    *,
    bounded: bool = True,
) -> None:
    """Refuse valid pixels that are not finite or, if `bounded`, outside [0, 1].

    Args:
        image: The image to be checked.
        valid: True where a pixel is looked at.
        what: Name of the image, for errors.
        bounded: Whether values must be in [0, 1]; else they need only be finite.
    Raises: DataError naming the first bad pixel, its value and how many there are.
    """
    values = image.detach().cpu().numpy()
    if bounded and values.size and values.min() >= 0 and values.max() <= 1:  # also no NaN
        return
    good = np.isfinite(values)
    expected = "finite numbers"
    if bounded:
        good &= (values >= 0) & (values <= 1)
        expected = "values in [0, 1]; clamp them first"
    bad = np.argwhere(~good.all(axis=2) & valid)
    if len(bad):
        row, column = bad[0]
        channel = int(np.argmin(good[row, column]))
        raise DataError(
            f"{what}: {values[row, column, channel]:g} in {'RGB'[channel]} at row {row}, "
            f"column {column} ({len(bad)} such pixels), expected {expected}"
        )


def mean_over(values: Float[np.ndarray, "h w *c"], where: Bool[np.ndarray, "h w"]) -> float:
    """Mean of the values (over channels too) where `where` holds; nan where it never does.

    Args:
        values: Value at each pixel, in any unit.
        where: True where a pixel counts.
    """
    # to pick all pixels takes longer than their mean; of another layout the sum has another order
    whole = values.flags.c_contiguous and where.all()
    chosen = values if whole else values[where]
    return float(chosen.mean()) if chosen.size else float("nan")


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]} px"


def _blanked(
    image: Float[Tensor, "h w 3"], valid: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    values = image.detach().cpu().numpy().astype(np.float64)
    if not valid.all():
        np.copyto(values, 0, where=~valid[..., None])
    return values
