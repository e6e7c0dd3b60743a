"""Short trainings on small photos, judged on training views that they did not see."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.methods.auto.base import started
from splatproof.methods.auto.spreading import spread
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.exposure import explicit, exposed
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.resolution import Resolution, shrunk
from splatproof.reference.types.scene import Scene, View

HELD = 6
"""One training view in so many is held out, at least two of them."""
MOST_VIEWS = 60
"""Most training views that a probe looks at, those nearest to the middle one: neighbours still overlap."""
SURE = 2.0
"""Standard errors that a gain has to be above 0."""
PIXELS = 12_000
"""About as many pixels a photo of a probe has."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Probe:
    """Training views apart in two: those that short trainings see, and those that judge them."""

    scene: Scene
    """The scene with small photos; its training views are those that are seen."""
    held: tuple[View, ...]
    """The others, small too."""
    photos: tuple[Float[Tensor, "h w 3"], ...]
    """Their photos."""
    run: Run
    """Seed, background and threads of the trainings; no folder."""

    def score(self, settings: Settings, attempt: int = 0) -> tuple[float, ...]:
        """PSNR of each held-out view after a whole training under some settings.

        Nothing is fitted to a held-out photo: a model with exposures shows it in the mean exposure of those that it
        saw, as a protocol scores test photos of which it gives methods no part. Were it fitted, exposures would always win.

        Args:
            settings: What is tried; photos are not shrunk further.
            attempt: Number from 0; each has draws of its own.
        """
        settings = replace(settings, resolution=Resolution())
        run = replace(self.run, seed=self.run.seed + attempt)
        start = started(self.scene, settings, run, "3dgs")
        model, plan = prepare(start, settings, run)
        trainer = Trainer(exposed(model, settings.exposure, plan.views), plan, run)
        while trainer.step < plan.steps:
            trainer.advance()
        fitted = explicit(trainer.model, self.scene, self.run.backend)
        background = torch.tensor(self.run.background)
        return tuple(
            psnr(fitted.render(view.without_truth(), background).colour, photo, valid_of(view))
            for view, photo in zip(self.held, self.photos, strict=True)
        )


def probe_of(scene: Scene, run: Run) -> Probe | None:
    """Hold every sixth of the views out, spread over the scene's order; None with fewer than four.

    Args:
        scene: The scene as a method gets it.
        run: Seed, background and backend.
    """
    if len(scene.train) < 4:
        return None
    near = nearest(scene)
    count = max(2, len(near) // HELD)
    held = spread(near, count)
    small = list(scene.views)
    for index in near:
        view = scene.views[index]
        factor = max(1.0, math.sqrt(view.camera.width * view.camera.height / PIXELS))
        small[index] = kept(shrunk(view, factor))
    rest = tuple(index for index in near if index not in held)
    views = tuple(small[index] for index in sorted(held))
    return Probe(
        scene=replace(scene, views=tuple(small), train=rest, test=()),
        held=views,
        photos=tuple(view.load() for view in views),
        run=replace(run, folder=None),
    )  # fmt: skip


def nearest(scene: Scene) -> list[int]:
    """Indices of the training views that a probe looks at, rising.

    Args:
        scene: With training views.
    """
    if len(scene.train) <= MOST_VIEWS:
        return list(scene.train)
    centres = torch.stack([view.camera.centre.double() for view in scene.train_views])
    distance = (centres - centres.median(dim=0).values).norm(dim=1)
    return sorted(scene.train[row] for row in distance.argsort(stable=True)[:MOST_VIEWS].tolist())


def kept(view: View) -> View:
    """The view with its photo in memory from the first time on that it is read.

    Args:
        view: A small one: several trainings read it.
    """
    held: list[Tensor] = []

    def load() -> Tensor:
        if not held:
            held.append(view.load())
        return held[0]

    return replace(view, load=load)


def valid_of(view: View) -> Bool[Tensor, "h w"] | None:
    """The pixels of a view that count; None: all of them.

    Args:
        view: One that a photo is compared for.
    """
    return None if view.load_mask is None else view.load_mask()


def psnr(
    image: Float[Tensor, "h w 3"],
    photo: Float[Tensor, "h w 3"],
    valid: Bool[Tensor, "h w"] | None = None,
) -> float:
    """10 log10 (1 / MSE) of an image in [0, 1] after clamping, at most 100.

    Args:
        image: Render, not clamped.
        photo: What it is compared with.
        valid: The pixels that count; None, or where there are none: all of them.
    """
    off = (image.clamp(0, 1) - photo).square()
    error = float((off if valid is None or not valid.any() else off[valid]).mean())
    return -10 * math.log10(max(error, 1e-10))


def better(candidate: Sequence[float], best: Sequence[float], least: float) -> bool:
    """Whether a candidate beats what is best so far: by `least` dB and two standard errors, in pairs.

    Args:
        candidate: PSNR of each held-out view.
        best: PSNR of the same views.
        least: Decibels that a choice other than the usual one has to gain.
    """
    gains = [one - other for one, other in zip(candidate, best, strict=True)]
    mean = sum(gains) / len(gains)
    if len(gains) < 2:
        return mean > least
    spread = math.sqrt(sum((gain - mean) ** 2 for gain in gains) / (len(gains) - 1))
    return mean > max(least, SURE * spread / math.sqrt(len(gains)))
