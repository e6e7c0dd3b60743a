"""Training of our own matcher on worlds whose depth is known."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from splatproof.base.errors import DataError
from splatproof.methods.priors.own_matcher import (
    FINE,
    MIDDLE,
    MatchNetwork,
    OwnMatcher,
    Said,
    peak,
)
from splatproof.methods.priors.plane_sweep import (
    STRIDE,
    Pair,
    pair_of,
    pixels,
    positions,
    smaller,
    window,
)
from splatproof.methods.priors.unet import fitted
from splatproof.reference.supervision.dense_initialisation import (
    DenseSettings,
    observations,
    rows_of,
    seen_by_both,
    select_pairs,
)
from splatproof.reference.supervision.dense_matching import match_by_flow, plane_between
from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import Scene, View

PAIRS = DenseSettings()
"""Who is matched with whom: as before a training."""
SAME = 0.02
"""Share of a depth by which what B shows may be nearer before it hides the point of A."""
RATE = 3e-3
"""Adam's rate at the start: after 200 steps the loss was 3.9, and 4.2 at a third of it."""
CROP = (96, 128)
"""Rows and columns of what is trained on at a time, multiples of STRIDE."""
LIGHT, GRAIN = 0.4, 0.03
"""Photos of a pair are brought to powers exp(+-LIGHT) of their colours, and get noise of a deviation up to GRAIN."""
EXACT = 0.5
"""Weight of the error of the answer, in planes of the second sweep, beside the two cross entropies."""
COMPARED = 12
"""Pairs of a scene that matchers are compared on, spread over all."""
NEAR_MISS = 1.0
"""Pixels beyond which a match counts as off."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """A pair as the network sees it, and what it should say."""

    pair: Pair
    truth: Float[Tensor, "h w"]
    """k of the true surface; 0 where none is known."""
    known: Bool[Tensor, "h w"]
    """Pixels of A whose surface B shows too."""


def pairs_of(scene: Scene) -> Iterator[tuple[View, View, Float[Tensor, "n 3"]]]:
    """Training views that are matched, both ways, and the sparse points that both see.

    Args:
        scene: A made world, with its truth.
    Raises: DataError where a view has no true depth.
    """
    seen = rows_of(observations(scene.points, len(scene.views)), scene.train)
    views, positions = scene.train_views, scene.points.positions
    for view in views:
        if view.load_depth is None:
            raise DataError(f"{scene.name}: view {view.name} has no true depth to train on")
    centres = torch.stack([view.camera.centre for view in views])
    for a, b in select_pairs(centres, positions, seen, PAIRS) if seen.nnz else []:
        shared = positions[seen_by_both(seen, a, b)]
        yield views[a], views[b], shared
        yield views[b], views[a], shared


def samples_of(scene: Scene) -> list[Sample]:
    """All pairs of a scene's training views, both ways.

    Args:
        scene: A made world, with its truth.
    Raises: DataError where a view has no true depth.
    """
    found = []
    for first, second, shared in pairs_of(scene):
        (a, photo), (b, other) = (smaller(view.camera, view.load()) for view in (first, second))
        pair = pair_of(a, b, photo, other, shared)
        if pair is None:
            continue
        depth, known = true_depth(first, a)
        known &= shown(a, b, depth, true_depth(second, b)[0])[1]
        more = (0, pair.covered.shape[1] - a.width, 0, pair.covered.shape[0] - a.height)
        known = functional.pad(known, more)
        inverse = functional.pad(1 / depth, more, value=1.0)
        plane = (pixels(*known.shape) @ pair.planes.slope).float()
        found.append(Sample(pair=pair, truth=torch.where(known, inverse / plane, 0), known=known))
    return found


def true_depth(view: View, camera: Camera) -> tuple[Float[Tensor, "h w"], Bool[Tensor, "h w"]]:
    """True depth of each pixel, 1 where there is no surface, and where there is one.

    Args:
        view: A view with truth.
        camera: Its camera, of the size that is wanted.
    """
    assert view.load_depth is not None
    size = (camera.height, camera.width)
    depth = functional.interpolate(view.load_depth()[None, None], size)[0, 0]
    known = depth.isfinite() & (depth > 0)
    return torch.where(known, depth, 1), known


def shown(
    first: Camera,
    second: Camera,
    depth: Float[Tensor, "h w"],
    other: Float[Tensor, "hb wb"],
) -> tuple[Float[Tensor, "h w 2"], Bool[Tensor, "h w"]]:
    """Where the surface of each pixel of A lies in B, and whether B shows it.

    Args:
        first: Camera of photo A.
        second: Camera of photo B.
        depth: True depth of A.
        other: True depth of B.
    """
    at, z = project_points(second, unproject(first, depth.double()))
    inside = (at >= 0).all(dim=1) & (z > 0)
    inside &= (at < at.new_tensor([second.width, second.height])).all(dim=1)
    column, row = torch.where(inside[:, None], at, 0).floor().long().T
    seen = inside & ((other[row, column] - z).abs() <= SAME * z)
    return at.reshape(*depth.shape, 2), seen.reshape(depth.shape)


def loss_of(said: Said, scales: Float[Tensor, " d"], sample: Sample) -> Float[Tensor, ""]:
    """Cross entropy of both sweeps' planes, and the error of the answer.

    Between two planes the truth is each of them by its nearness. Only what lies among a sweep's planes counts there.

    Args:
        said: What the network says of the pair.
        scales: k of the first sweep's planes.
        sample: The pair and its truth.
    """
    coarse = (slice(STRIDE // 2, None, STRIDE), slice(STRIDE // 2, None, STRIDE))
    number = (sample.truth[coarse] - scales[0]) / (scales[1] - scales[0])
    total = _entropy(said.coarse, number, sample.known[coarse])
    number = (sample.truth - said.start) / said.step + MIDDLE
    total = total + _entropy(said.fine, number, sample.known)
    among = sample.known & (number >= 0) & (number <= FINE - 1)
    off = functional.smooth_l1_loss(peak(said.fine)[0], number, reduction="none")
    return total + EXACT * torch.where(among, off, 0).sum() / among.sum().clamp(min=1)


def _entropy(
    logits: Float[Tensor, "d h w"], number: Float[Tensor, "h w"], known: Bool[Tensor, "h w"]
) -> Float[Tensor, ""]:
    counted = known & (number >= 0) & (number <= len(logits) - 1)
    below = number.clamp(0, len(logits) - 2).floor()
    share = (number - below).clamp(0, 1)
    chance = logits.log_softmax(dim=0)
    low, high = (chance.gather(0, below.long()[None] + more)[0] for more in (0, 1))
    said = (1 - share) * low + share * high
    return -torch.where(counted, said, 0).sum() / counted.sum().clamp(min=1)


def train(
    samples: Sequence[Sample],
    *,
    steps: int,
    seed: int = 0,
    report: Callable[[int, int, float], None] = lambda step, steps, loss: None,
) -> MatchNetwork:
    """Fit a network, a part of a pair a step; equal samples and seed give equal weights on one machine.

    Args:
        samples: Pairs of photos, drawn with replacement.
        steps: Number of pairs that are drawn.
        seed: Seed of weights and draws.
        report: Told (step, steps, loss).
    Raises: DataError where no pair shows anything in common.
    """
    fit_for = [sample for sample in samples if sample.known.any()]
    if not fit_for:
        raise DataError("no pairs of photos to train the matcher on")

    def loss(network: MatchNetwork, draw: torch.Generator) -> Float[Tensor, ""]:
        sample = part(fit_for[int(torch.randint(len(fit_for), (), generator=draw))], draw)
        pair = sample.pair
        seen = replace(pair, photo=_taken(pair.photo, draw), other=_taken(pair.other, draw))
        return loss_of(network(seen), pair.planes.scales.float(), sample)

    return fitted(MatchNetwork, loss, steps=steps, seed=seed, report=report, rate=RATE)


def part(sample: Sample, draw: torch.Generator) -> Sample:
    """CROP pixels of a pair, or all of a smaller one; what moves out of them is not known there.

    Args:
        sample: A whole pair.
        draw: Where the part lies.
    """
    rows, columns = (
        slice(low, low + kept)
        for side, kept in (
            (side, min(side, most)) for side, most in zip(sample.known.shape, CROP, strict=True)
        )
        for low in (int(torch.randint(side - kept + 1, (), generator=draw)),)
    )
    pair, truth = window(sample.pair, rows, columns), sample.truth[rows, columns]
    at = positions(pair.planes, pixels(*truth.shape), truth[None])[0]
    within = ((at >= 0) & (at < at.new_tensor([truth.shape[1], truth.shape[0]]))).all(dim=-1)
    return Sample(pair=pair, truth=truth, known=sample.known[rows, columns] & within)


def _taken(photo: Float[Tensor, "3 h w"], draw: torch.Generator) -> Float[Tensor, "3 h w"]:
    """A photo in another light, with noise."""
    power, grain = torch.rand(2, generator=draw).tolist()
    noise = GRAIN * grain * torch.randn(photo.shape, generator=draw)
    return photo.clamp(min=0) ** float(torch.tensor(LIGHT * (2 * power - 1)).exp()) + noise


def errors(network: MatchNetwork, scene: Scene) -> dict[str, dict[str, float]]:
    """How optical flow and the network match about COMPARED pairs of a scene, by name: shares and pixels.

    Of the pixels that the other photo shows: `sure`, the share of matches that become points by their certainty; of
    these `median`, their distance from the truth in pixels, and `off`, the share beyond NEAR_MISS.

    Args:
        network: The network.
        scene: A made world, with its truth.
    Raises: DataError where a view has no true depth, or no pair shows anything in common.
    """
    matcher, found = OwnMatcher(network), {"flow": [], "own": []}
    count = 0
    pairs = list(pairs_of(scene))
    for first, second, shared in pairs[:: max(1, len(pairs) // COMPARED)]:
        depth, known = true_depth(first, first.camera)
        true, seen = shown(first.camera, second.camera, depth, true_depth(second, second.camera)[0])
        image, other, seen = first.load(), second.load(), seen & known
        count += int(seen.sum())
        here, there = (project_points(view.camera, shared)[0] for view in (first, second))
        said = {
            "flow": match_by_flow(image, other, plane_between(here, there)),
            "own": matcher(first.camera, second.camera, image, other, shared),
        }
        for name, (warp, certainty) in said.items():
            sure = seen & (certainty >= PAIRS.certainty)
            off = (warp + pixels(*seen.shape)[..., :2] - true).norm(dim=-1)
            found[name].append(off[sure])
    if not count:
        raise DataError(f"{scene.name}: no pairs of photos to compare matchers on")
    whole = {name: torch.cat(parts) for name, parts in found.items()}
    return {
        name: {
            "sure": len(off) / count, "median": float(off.median()) if len(off) else 0.0,
            "off": float((off > NEAR_MISS).double().mean()) if len(off) else 0.0,
        }
        for name, off in whole.items()
    }  # fmt: skip
