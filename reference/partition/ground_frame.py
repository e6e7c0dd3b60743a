"""An upright frame for partitions that divide the ground: x, y along the ground, z up."""

import torch
from jaxtyping import Float64
from torch import Tensor


def ground_frame(
    up: Float64[Tensor, "3"], positions: Float64[Tensor, "n 3"]
) -> Float64[Tensor, "3 3"]:
    """Rotation R (rows: x, y, up) whose x axis lies along the greatest spread of the positions.

    Points in the frame are p R^T. VastGaussian and CityGaussian turn scenes by hand so that their
    grids follow the flight; the spread of the camera centres does that here.

    Args:
        up: Unit vector against gravity.
        positions: Camera centres, or points; with fewer than two the x axis is arbitrary but fixed.

    Source: VastGaussian, Sec. 4.1 (Manhattan alignment); automatic: ours.
    """
    helper = torch.eye(3, dtype=torch.float64)[up.abs().argmin()]
    first = torch.linalg.cross(helper, up)
    first = first / first.norm()
    second = torch.linalg.cross(up, first)
    flat = positions @ torch.stack([first, second], dim=1)
    flat = flat - flat.mean(dim=0) if len(flat) else flat
    along = torch.linalg.eigh(flat.T @ flat).eigenvectors[:, -1]
    along = along * along[along.abs().argmax()].sign()
    x = along[0] * first + along[1] * second
    return torch.stack([x, torch.linalg.cross(up, x), up])
