"""What a plan trains: the model of another method, with the settings that were planned."""

import math
from dataclasses import fields, replace
from typing import Literal

from splatproof.methods.auto.points import with_enough
from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.settings import SkySettings
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.exposure import explicit
from splatproof.methods.pvg import fit as pvg
from splatproof.methods.pvg.settings import MovingDensity
from splatproof.methods.pvg.settings import Settings as MovingSettings
from splatproof.methods.stratosplat import fit as stratosplat
from splatproof.methods.stratosplat.own_prior import completion_words
from splatproof.methods.stratosplat.settings import Completion, Planes, StratoSplat
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.cost import largest
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.fewer_points import with_at_most
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.resolution import Resolution
from splatproof.reference.types.scene import Scene

Base = Literal["3dgs", "pvg", "stratosplat"]
"""Method whose model is trained: Gaussians that stand still; that move; that stand still, start from completed
depths, and have virtual ones beside them."""
STRIDE = 4
"""Pixels between the rays that virtual Gaussians lie on, in photos of up to `STRIDE_PIXELS`; larger photos have as many rays,
so that a step takes no longer for them. Six photos of caliterra at 400 px, 800 steps: 24.9 dB, and with the method's usual 2 24.7
dB in twice the time."""
STRIDE_PIXELS = 120_000.0
"""Pixels of the photos that `STRIDE` was tried on, 400 x 300."""


def without_what_is_lacking(settings: Settings) -> Settings:
    """Planned settings without what Gaussians that move do not have.

    Args:
        settings: As they would be of method 3dgs.
    """
    return replace(
        settings, resolution=Resolution(), opacity_weight=0.0, dropout=0.0, random_background=False,
        density=replace(settings.density, split_gradient=0.0),
    )  # fmt: skip


def moving(settings: Settings, scene: Scene) -> MovingSettings:
    """Settings of method pvg for a plan: its own terms, the plan's length, density and colours.

    Args:
        settings: What was planned.
        scene: Whether it has masks of the sky counts.
    """
    skies = any(view.load_sky is not None for view in scene.train_views)
    density = {part.name: getattr(settings.density, part.name) for part in fields(Density)}
    return MovingSettings(
        iterations=settings.iterations, views_per_step=settings.views_per_step,
        sh_degree=settings.sh_degree, sh_interval=settings.sh_interval,
        initial_opacity=settings.initial_opacity, exposure=settings.exposure, dssim=settings.dssim,
        sky=SkySettings() if skies else SkySettings(resolution=0, weight=0.0),
        density=MovingDensity(**density),
    )  # fmt: skip


def completed(settings: Settings, scene: Scene) -> StratoSplat:
    """Settings of method stratosplat for a plan: its own start and memory, and all that was planned.

    Depths are completed from what our own network says, where the photos have no depth prior: of made flights, which it
    knows, from three views it gains 1.6 dB (docs/sparse.md), and of photos that it does not know the points
    contradict it, so that it is left out.

    Args:
        settings: What was planned.
        scene: The size of its photos counts, and whether they have depth priors.
    """
    planned = {part.name: getattr(settings, part.name) for part in fields(Settings)}
    wider = math.sqrt(max(1.0, largest(scene) / STRIDE_PIXELS))
    return StratoSplat(
        **planned, planes=Planes(stride=round(STRIDE * wider)),
        completion=Completion(prior="scene" if "depth_prior" in scene.facts else "own"),
    )  # fmt: skip


def started(scene: Scene, settings: Settings, run: Run, base: Base) -> Scene:
    """The scene with the points that training starts from: of those that stand still never fewer than `LEAST_POINTS`.

    Args:
        scene: As a method gets it.
        settings: What was planned.
        run: Seed of the draws and bound on photos in memory, and told whose weights completed depths; nothing is
            written to its folder.
        base: What is trained.

    Raises: As methods 3dgs and stratosplat.
    """
    if base == "pvg":
        return threedgs.started(scene, settings, run)
    if base == "3dgs":
        whole = with_enough(
            threedgs.started(scene, replace(settings, most_points=None), run), run.seed
        )
        return whole if settings.most_points is None else with_at_most(whole, settings.most_points)
    chosen = completed(settings, scene)
    words = completion_words(chosen, scene)
    if words:
        run.on_fact("completion network", words)
    points = stratosplat.started(scene, chosen, replace(run, folder=None))
    return replace(scene, points=points)


def prepare(scene: Scene, settings: Settings, run: Run, base: Base) -> tuple[Model, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: The scene, with the points to start from.
        settings: What was planned.
        run: The run.
        base: What is trained.

    Raises: As methods 3dgs, pvg and stratosplat.
    """
    if base == "3dgs":
        return threedgs.prepare(scene, settings, run)
    if base == "stratosplat":
        return stratosplat.prepare_from(scene, completed(settings, scene), run)
    model, plan = pvg.prepare(scene, moving(settings, scene), run)
    return model, replace(plan, shapes=settings.shapes)


def finished(model: Model, scene: Scene, backend: str, base: Base) -> Reconstruction:
    """What a training leaves behind.

    Args:
        model: The model after its last step.
        scene: What it was trained on; its shift and units count.
        backend: Name of the rasterizer.
        base: What was trained.
    """
    if base == "3dgs":
        return explicit(model, scene, backend)
    kind = pvg.KIND if base == "pvg" else stratosplat.KIND
    return DecodedModel.of(kind, model, scene, backend)
