"""What a plan trains: Gaussians that stand still, as method 3dgs's, or that move, as method pvg's."""

from dataclasses import fields, replace

from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.settings import SkySettings
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.exposure import explicit
from splatproof.methods.pvg import fit as pvg
from splatproof.methods.pvg.settings import MovingDensity
from splatproof.methods.pvg.settings import Settings as MovingSettings
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.resolution import Resolution
from splatproof.reference.types.scene import Scene


def without_what_is_lacking(settings: Settings) -> Settings:
    """Planned settings without what Gaussians that move do not have.

    Args:
        settings: As they would be if everything stood still.
    """
    return replace(
        settings, resolution=Resolution(), opacity_weight=0.0, dropout=0.0, random_background=False
    )


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


def prepare(scene: Scene, settings: Settings, run: Run, *, moves: bool) -> tuple[Model, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: The scene, with the points to start from.
        settings: What was planned.
        run: The run.
        moves: Whether Gaussians move.

    Raises: As methods 3dgs and pvg.
    """
    if not moves:
        return threedgs.prepare(scene, settings, run)
    model, plan = pvg.prepare(scene, moving(settings, scene), run)
    return model, replace(plan, widest=settings.widest)


def finished(model: Model, scene: Scene, backend: str, *, moves: bool) -> Reconstruction:
    """What a training leaves behind.

    Args:
        model: The model after its last step.
        scene: What it was trained on; its shift and units count.
        backend: Name of the rasterizer.
        moves: Whether Gaussians move.
    """
    if moves:
        return DecodedModel.of(pvg.KIND, model, scene, backend)
    return explicit(model, scene, backend)
