"""Training of our own depth network on worlds whose depth is known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.base.errors import DataError
from splatproof.methods.priors.network import DepthNetwork, network_input
from splatproof.methods.priors.unet import fitted
from splatproof.reference.supervision.dense_initialisation import observations, points_of
from splatproof.reference.types.scene import Scene

WITHOUT_POINTS = 0.2
"""Share of samples whose sparse points are hidden: scenes may have none."""
FEWEST_POINTS = 0.02
"""Least share of the points that other samples keep, log-uniform up to 1: few photos have few."""
Points = Callable[
    [Float[Tensor, "n 5 h w"], Float[Tensor, "n h w"], Bool[Tensor, "n h w"], torch.Generator],
    None,
]
"""points(given, truth, known, draw): put the sparse points of a batch in the last two channels of `given`."""
FLAT = 1e-3
"""Least deviation of a true map as a share of its mean: a plane seen straight on teaches nothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """A view as the network sees it, and what it should say."""

    given: Float[Tensor, "5 h w"]
    truth: Float[Tensor, "h w"]
    """True disparity; 0 in the sky."""
    known: Bool[Tensor, "h w"]


def samples_of(scene: Scene) -> list[Sample]:
    """All training views of a scene.

    Args:
        scene: A made world, with its truth.
    Raises: DataError where a view has no true depth.
    """
    seen = observations(scene.points, len(scene.views))
    found = []
    for index in scene.train:
        view = scene.views[index]
        if view.load_depth is None:
            raise DataError(f"{scene.name}: view {view.name} has no true depth to train on")
        given = network_input(view, scene.points.positions[points_of(seen, index)])
        depth = functional.interpolate(view.load_depth()[None, None], given.shape[1:])[0, 0]
        known = depth > 0
        found.append(Sample(given=given, truth=torch.where(known, 1 / depth, 0), known=known))
    return found


def affine_loss(
    said: Float[Tensor, "n h w"], truth: Float[Tensor, "n h w"], known: Bool[Tensor, "n h w"]
) -> Float[Tensor, ""]:
    """Mean |d' - t'| of both maps, each less its mean and over its mean absolute deviation, by view.

    Scale and zero do not count, the sign does: fitted freely it could be learnt the wrong way round.

    Args:
        said: Disparity d that the network says.
        truth: True disparity t.
        known: Pixels that count; each view has some.
    Source: Ranftl et al. 2020 (MiDaS), Eqs. 5 to 7; means instead of medians: ours.
    """
    weight = known.to(said).flatten(1)
    count = weight.sum(dim=1, keepdim=True)

    def normalised(values: Float[Tensor, "n p"], least: float) -> Float[Tensor, "n p"]:
        mean = (weight * values).sum(dim=1, keepdim=True) / count
        off = values - mean
        deviation = (weight * off.abs()).sum(dim=1, keepdim=True) / count
        return off / torch.maximum(deviation, least * mean.abs()).clamp(min=1e-9)

    off = normalised(said.flatten(1), 0.0) - normalised(truth.flatten(1), FLAT)
    return ((off.abs() * weight).sum(dim=1) / count[:, 0]).mean()


def hide_points(
    given: Float[Tensor, "n 5 h w"],
    truth: Float[Tensor, "n h w"],
    known: Bool[Tensor, "n h w"],
    draw: torch.Generator,
) -> None:
    """Leave few of the points of structure from motion or none, in place.

    Args:
        given: What the network sees, its own points in the last two channels.
        truth: Not used.
        known: Not used.
        draw: Source of what is hidden.
    """
    del truth, known
    hidden = torch.rand(len(given), generator=draw) < WITHOUT_POINTS
    given[hidden, 3:] = 0
    kept = FEWEST_POINTS ** torch.rand(len(given), 1, 1, 1, generator=draw)
    given[:, 3:] *= torch.rand(len(given), 1, *given.shape[2:], generator=draw) < kept


def train(
    samples: Sequence[Sample],
    *,
    steps: int,
    points: Points = hide_points,
    batch: int = 4,
    seed: int = 0,
    report: Callable[[int, int, float], None] = lambda step, steps, loss: None,
) -> DepthNetwork:
    """Fit a network; equal samples and seed give equal weights on one machine.

    Args:
        samples: Views; a batch holds views of one size.
        steps: Number of batches.
        points: Draws the sparse points of a batch.
        batch: Samples a batch, drawn with replacement and mirrored half of the time.
        seed: Seed of weights and draws.
        report: Told (step, steps, loss).
    Raises: DataError without samples.
    """
    if not samples:
        raise DataError("no views to train the depth network on")

    def loss(network: DepthNetwork, draw: torch.Generator) -> Float[Tensor, ""]:
        first = samples[int(torch.randint(len(samples), (), generator=draw))]
        alike = [one for one in samples if one.truth.shape == first.truth.shape]
        rows = torch.randint(len(alike), (batch,), generator=draw).tolist()
        given = torch.stack([alike[row].given for row in rows])
        truth = torch.stack([alike[row].truth for row in rows])
        known = torch.stack([alike[row].known for row in rows])
        points(given, truth, known, draw)
        if torch.rand((), generator=draw) < 0.5:
            given, truth, known = (maps.flip(-1) for maps in (given, truth, known))
        return affine_loss(network(given), truth, known)

    return fitted(DepthNetwork, loss, steps=steps, seed=seed, report=report)
