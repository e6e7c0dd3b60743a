"""Motion that is smooth in time without another loss: a view drawn from the state of another moment."""

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.model import Moment


def skipped(moment: Moment, probability: float, reach: float) -> float:
    """Model time between the moment of a view and the one whose state is drawn for it; 0 after training.

    Args:
        moment: Its generator draws whether this step is smoothed, and by how much.
        probability: How likely a step is smoothed, 0 to 1.
        reach: Greatest time between the two moments, >= 0.

    Source: PVG's release (half of the steps, up to one and a half frames).
    """
    if moment.generator is None or not probability:
        return 0.0
    chance, place = torch.rand(2, generator=moment.generator).tolist()
    return (2 * place - 1) * reach if chance < probability else 0.0


def average_velocities(
    velocities: Float[Tensor, "n 3"], spans: Float[Tensor, " n"], period: float, decay: float
) -> Float[Tensor, "n 3"]:
    """v exp(-decay beta / (2 p)): how fast something moves on the whole; 0 for what stays long.

    Args:
        velocities: v, at the peak of life.
        spans: beta, spans of life, in the unit of the period.
        period: p of the vibration, > 0.
        decay: How fast the average velocity falls with the span of life in periods, >= 0.

    Source: Chen et al. 2023, "Periodic Vibration Gaussian", Sec. 3.4.
    """
    return velocities * torch.exp(-decay * spans / (2 * period))[:, None]
