"""A metric's value of one image: whoever wrote the metric, it harms no other and is told by name."""

import numbers

from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError, SplatproofError, UsageError
from splatproof.metrics.registry import BUILT_IN, Metric


def taken(
    metric: Metric,
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "h w 3"],
    mask: Bool[Tensor, "h w"] | None,
    *,
    name: str,
) -> float:
    """The metric's value, which is nan where it is undefined.

    Another's metric gets tensors of its own, since one that writes into them would change what the
    metrics behind it see.

    Args:
        metric: Ours, or that of a package or plug-in file.
        image: What the method shows, in [0, 1].
        target: What the camera saw, in [0, 1].
        mask: True where a pixel counts; None: everywhere.
        name: Name of the view, for errors.
    Raises: DataError where the images cannot be scored; UsageError where another's metric fails or
        gives no number.
    Source: ours.
    """
    try:
        if metric.name in BUILT_IN:
            return metric.function(image, target, mask)
        copies = image.clone(), target.clone(), None if mask is None else mask.clone()
        return _number(metric.function(*copies))
    except DataError as error:
        raise DataError(f"{name}: {error}") from error
    except SplatproofError:
        raise
    except Exception as error:
        if metric.name in BUILT_IN:
            raise
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise UsageError(f"metric {metric.name}: fails on {name} ({said}); mend it") from error


def _number(value: object) -> float:
    """A value as a float. Raises: TypeError where it is not one number."""
    if isinstance(value, Tensor) and value.ndim == 0 and not value.is_complex():
        return float(value)
    if not isinstance(value, numbers.Real):
        raise TypeError(f"it gave a {type(value).__name__}, expected a float")
    return float(value)
