"""Training of our own refiner of side views, on worlds whose side views are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.side_views import Guide
from splatproof.methods.priors.unet import STRIDE, fitted
from splatproof.methods.priors.view_refiner import WARPED, RefinerNetwork, refiner_input
from splatproof.methods.threedgs.fit import fit
from splatproof.methods.threedgs.settings import ThreeDGS
from splatproof.reference.types.scene import Scene

CROP = 96
"""Sides in pixels of what is trained on at a time."""
SHORT, LONG = 1, 3
"""The models that draw side views are trained for so many steps in units of `steps`: early and late ones."""
MATCHED, DRAWN = 4.0, 10_000
"""Pixels a matched point that these models start from, and points drawn where a scene has none at all."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """A side view as the network sees it, and what it should say."""

    given: Float[Tensor, "8 h w"]
    truth: Float[Tensor, "3 h w"]
    counted: Bool[Tensor, "h w"]
    """Pixels without evidence: a refiner's word counts there alone."""


def samples_of(scene: Scene, *, steps: int, seed: int = 0) -> list[Sample]:
    """The test views of a scene as models draw them that were trained on its training views alone.

    Args:
        scene: With photos of its test views.
        steps: Steps of the shorter of two trainings.
        seed: Seed of the trainings.

    Raises: DataError for a scene that cannot be trained on or has no test view.
    """
    if not scene.test:
        raise DataError(f"{scene.name}: no held-out views to learn side views from")
    found = []
    for length in (SHORT, LONG):
        settings = ThreeDGS(
            iterations=length * steps, dense_cell=MATCHED, random_points=DRAWN
        )  # fmt: skip
        model = fit(scene.for_training(), settings, Run(seed=seed, threads=1))
        guide = Guide(scene.train_views, model.render)
        views = scene.test_views
        guided = guide.of([view.camera for view in views])
        for view, (side, proven, best) in zip(views, guided, strict=True):
            found.append(
                Sample(
                    given=refiner_input(side, guide.texture(best)), truth=view.load().permute(2, 0, 1),
                    counted=~proven,
                )
            )  # fmt: skip
    return found


def errors(network: RefinerNetwork | None, samples: Sequence[Sample]) -> dict[str, float]:
    """Mean absolute error where there is no evidence: of the render, of warping, and of the network.

    Args:
        network: None: it is left out.
        samples: Side views, at least one.
    """
    sums: dict[str, list[float]] = {"render": [], "warp": []}
    if network is not None:
        sums["own"] = []
    with torch.inference_mode():
        for sample in (one for one in samples if one.counted.any()):
            height, width = (STRIDE * (side // STRIDE) for side in sample.counted.shape)
            given = sample.given[:, :height, :width]
            said = {"render": (given[:3] + 1) / 2, "warp": (given[WARPED] + 1) / 2}
            if network is not None:
                said["own"] = network(given[None])[0].clamp(0, 1)
            truth, counted = sample.truth[:, :height, :width], sample.counted[:height, :width]
            for name, image in said.items():
                sums[name].append(float((image - truth).abs()[:, counted].mean()))
    return {name: sum(values) / len(values) for name, values in sums.items()}


def train(
    samples: Sequence[Sample],
    *,
    steps: int,
    batch: int = 4,
    seed: int = 0,
    report: Callable[[int, int, float], None] = lambda step, steps, loss: None,
) -> RefinerNetwork:
    """Fit a network to the mean absolute error of pixels without evidence, in crops.

    Equal samples and seed give equal weights on one machine.

    Args:
        samples: Side views of CROP pixels and more on either side.
        steps: Number of batches.
        batch: Crops a batch, drawn with replacement and mirrored half of the time.
        seed: Seed of weights and draws.
        report: Told (step, steps, loss).
    Raises: DataError where no sample is large enough and lacks evidence anywhere.
    """
    fit_for = [one for one in samples if min(one.counted.shape) >= CROP and one.counted.any()]
    if not fit_for:
        raise DataError(f"no side views of {CROP} pixels and more to train the refiner on")

    def loss(network: RefinerNetwork, draw: torch.Generator) -> Float[Tensor, ""]:
        crops = [_crop(fit_for, draw) for _ in range(batch)]
        given, truth, counted = (torch.stack(parts) for parts in zip(*crops, strict=True))
        if torch.rand((), generator=draw) < 0.5:
            given, truth, counted = (maps.flip(-1) for maps in (given, truth, counted))
        weight = counted[:, None].to(given)
        return ((network(given) - truth).abs() * weight).sum() / (3 * weight.sum()).clamp(min=1)

    return fitted(RefinerNetwork, loss, steps=steps, seed=seed, report=report)


def _crop(
    samples: Sequence[Sample], draw: torch.Generator
) -> tuple[Float[Tensor, "8 c c"], Float[Tensor, "3 c c"], Bool[Tensor, "c c"]]:
    """A square around a pixel without evidence."""
    sample = samples[int(torch.randint(len(samples), (), generator=draw))]
    places = sample.counted.nonzero()
    middle = places[int(torch.randint(len(places), (), generator=draw))]
    rows, columns = (
        slice(low, low + CROP)
        for low in (
            min(max(int(at) - CROP // 2, 0), side - CROP)
            for at, side in zip(middle, sample.counted.shape, strict=True)
        )
    )
    return (
        sample.given[:, rows, columns], sample.truth[:, rows, columns], sample.counted[rows, columns],
    )  # fmt: skip
