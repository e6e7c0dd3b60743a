"""How far a reconstructed cloud is from a reference cloud, and the other way round."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.base.errors import DataError, UsageError


@dataclass(frozen=True, kw_only=True)
class GeometryScores:
    """Distances in the clouds' unit, shares in [0, 1]; nan where undefined."""

    accuracy: float
    """Mean distance of a reconstructed point to the nearest reference point; lower is better."""
    completeness_distance: float
    """Mean distance of a reference point to the nearest reconstructed point; lower is better."""
    precision: float
    """Share of reconstructed points within the threshold of a reference point."""
    completeness: float
    """Share of reference points within the threshold of a reconstructed point (recall)."""
    f_score: float
    """2 precision completeness / (precision + completeness); 0 where both are 0."""
    chamfer: float
    """(accuracy + completeness_distance) / 2; lower is better."""


def geometry_scores(
    reconstruction: Float[Tensor, "n 3"],
    reference: Float[Tensor, "m 3"],
    threshold: float,
    counted: Bool[Tensor, " m"] | None = None,
) -> GeometryScores:
    """Accuracy, completeness, F-score and chamfer distance of two clouds of one frame and unit.

    With `counted` (facades, say) completeness is that of the counted reference points, and accuracy
    that of the reconstructed points whose nearest reference point, among all, is counted; the
    distance of a counted reference point is to the nearest of all reconstructed ones.

    Args:
        reconstruction: Reconstructed points, in the frame and unit of the reference.
        reference: True points, evenly sampled, since every one weighs the same.
        threshold: Distance up to which (included) a point counts as found, > 0.
        counted: Which reference points count; None: all.
    Returns: Nothing reconstructed: completeness and f_score 0, the distances nan (accuracy) and
        inf. No reconstructed point near a counted one: accuracy, precision and chamfer nan.
    Raises: DataError on points that are not finite and on a reference in which nothing counts,
        UsageError on a threshold that is not positive.
    Source: Knapitsch et al. 2017, "Tanks and Temples", Sec. 4 (precision, recall, F-score);
        accuracy and completeness as means follow Jensen et al. 2014 (DTU).
    """
    _positive(threshold)
    found, true = _checked(reconstruction, "reconstruction"), _checked(reference, "reference")
    counts = np.ones(len(true), dtype=bool) if counted is None else counted.numpy()
    if not counts.any():
        raise DataError("reference: no point counts; give a cloud with counted points")
    if len(found) == 0:
        return GeometryScores(
            accuracy=math.nan,
            completeness_distance=math.inf,
            precision=math.nan,
            completeness=0.0,
            f_score=0.0,
            chamfer=math.inf,
        )
    out, owner = KDTree(true).query(found)
    out = np.asarray(out)[counts[owner]]
    back = np.asarray(KDTree(found).query(true[counts])[0])
    accuracy, precision = _mean(out), _mean(out <= threshold)
    distance, completeness = _mean(back), _mean(back <= threshold)
    both = (0.0 if math.isnan(precision) else precision) + completeness
    return GeometryScores(
        accuracy=accuracy,
        completeness_distance=distance,
        precision=precision,
        completeness=completeness,
        f_score=2 * precision * completeness / both if both and len(out) else 0.0,
        chamfer=(accuracy + distance) / 2,
    )


def completeness(
    reconstruction: Float[Tensor, "n 3"], reference: Float[Tensor, "m 3"], threshold: float
) -> float:
    """Share of the reference that is found, as geometry_scores has it, and nothing besides.

    The other scores cost most: points that float far from everything search the whole tree.

    Args:
        reconstruction: Reconstructed points, in the frame and unit of the reference.
        reference: True points that count, evenly sampled.
        threshold: Distance up to which (included) a point counts as found, > 0.
    Returns: Share in [0, 1]; 0 where nothing is reconstructed.
    Raises: DataError on points that are not finite and on a reference without points, UsageError
        on a threshold that is not positive.
    Source: as geometry_scores.
    """
    _positive(threshold)
    found, true = _checked(reconstruction, "reconstruction"), _checked(reference, "reference")
    if not len(true):
        raise DataError("reference: no point counts; give a cloud with counted points")
    if not len(found):
        return 0.0
    # what lies beyond the bound has an infinite distance, and the bound itself would too
    within = math.nextafter(threshold, math.inf)
    return _mean(KDTree(found).query(true, distance_upper_bound=within)[0] <= threshold)


def vertical_faces(
    normals: Float[Tensor, "m 3"], up: Float[Tensor, "3"], *, most_degrees: float = 20.0
) -> Bool[Tensor, " m"]:
    """Which points lie on facades: the surface is within `most_degrees` of vertical.

    Args:
        normals: Surface normals of the reference points, unit length, either sign.
        up: Unit vector against gravity.
        most_degrees: Largest angle between surface and vertical, in [0, 90].
    Source: ours.
    """
    return (normals @ up.to(normals)).abs() <= math.sin(math.radians(most_degrees))


def _positive(threshold: float) -> None:
    if not 0 < threshold < math.inf:
        raise UsageError(f"threshold is {threshold:g}, expected a positive distance")


def _checked(points: Float[Tensor, "n 3"], what: str) -> Float[np.ndarray, "n 3"]:
    bad = torch.where(~points.isfinite().all(dim=1))[0]
    if len(bad):
        raise DataError(
            f"{what}: point {int(bad[0])} is {points[bad[0]].tolist()} ({len(bad)} such points), "
            "expected finite coordinates"
        )
    return points.detach().double().numpy()


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else math.nan
