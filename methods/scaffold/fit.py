"""Training of method scaffold-gs."""

import torch

from splatproof.methods.anchors import networks
from splatproof.methods.anchors.control import AnchorControl
from splatproof.methods.anchors.model import BANK, NETWORKS, AnchorModel
from splatproof.methods.anchors.start import started, voxel_size
from splatproof.methods.contracts.model import Model, Schedule
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.exposure import exposed
from splatproof.methods.scaffold.settings import Rates, Settings
from splatproof.methods.training.initialise import extent, with_points
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import log_linear
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.terms import Frame, ImageTerm, Photometric, Term
from splatproof.reference.anchors import scaffold
from splatproof.reference.types import mlp
from splatproof.reference.types.scene import Scene

KIND = "scaffold-gs"
"""What its models are loaded as."""


def fit(scene: Scene, settings: Settings, run: Run) -> DecodedModel:
    """Train on scene.train_views and return the model.

    Args:
        scene: With sparse points and training views.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; SplatproofError if the loss stops being finite.

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3 and its release.
    """

    def prepared() -> tuple[Model, Plan]:
        start = with_points(scene, run, random_points=settings.random_points)
        model, plan = prepare(start, settings, run)
        return exposed(model, settings.exposure, plan.views), plan

    return DecodedModel.of(KIND, train(run, prepared), scene, run.backend)


def prepare(scene: Scene, settings: Settings, run: Run) -> tuple[AnchorModel, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: With the points to start from.
        settings: What is chosen about the method.
        run: Seed, background and backend are part of the plan's key; the seed draws the networks.

    Raises: DataError if there is no point or no training view.
    """
    density = settings.density
    voxel = settings.voxel or voxel_size(scene, settings.voxel_rule, density.coarsest)
    size = extent(scene)
    parameters = started(
        scene, voxel=voxel, k=settings.k, features=settings.features,
        shared=networks.named(drawn_networks(settings, run.seed)),
    )  # fmt: skip
    model = AnchorModel(
        parameters, schedules(settings.rates, [*parameters.shared]),
        with_distance=settings.distance,
    )  # fmt: skip
    return model, Plan(
        steps=settings.iterations,
        views=scene.train_views,
        terms=terms(settings),
        density=AnchorControl(
            density, iterations=settings.iterations, voxel=voxel, extent=size, k=settings.k
        ),
        key=run_key(scene, settings, run),
        views_per_step=settings.views_per_step,
    )


def drawn_networks(settings: Settings, seed: int) -> dict[str, mlp.Mlp]:
    """The networks at their start, by name.

    Args:
        settings: features, k, distance and feature_bank count.
        seed: Seed of the draw.
    """
    generator = torch.Generator().manual_seed(seed)
    extra = 4 if settings.distance else 3
    decoder = scaffold.create_decoder(settings.features, settings.k, generator, extra=extra)
    made = {name: getattr(decoder, name) for name in NETWORKS}
    if settings.feature_bank:
        made[BANK] = mlp.create((4, settings.features, 3), generator)
    return made


def schedules(rates: Rates, shared: list[str]) -> dict[str, Schedule]:
    """Rate of every trained tensor.

    Args:
        rates: Rate of each kind of tensor.
        shared: Names of the networks' tensors.
    """
    by_network = {
        "opacity": log_linear(rates.opacity, rates.opacity_final),
        "shape": log_linear(rates.shape, rates.shape),
        "colour": log_linear(rates.colour, rates.colour_final),
        BANK: log_linear(rates.bank, rates.bank_final),
    }
    return {
        "offsets": log_linear(rates.offsets, rates.offsets_final),
        "features": log_linear(rates.features, rates.features),
        "log_scales": log_linear(rates.log_scales, rates.log_scales),
    } | {name: by_network[name.partition(".")[0]] for name in shared}


def terms(settings: Settings) -> tuple[ImageTerm, ...]:
    """What method scaffold-gs minimises.

    Args:
        settings: dssim and volume count.
    """
    image = Photometric(dssim=settings.dssim)
    if not settings.volume:
        return (image,)
    return (image, Term(name="volume", loss=mean_volume, weight=settings.volume))


def mean_volume(frame: Frame) -> torch.Tensor:
    """Mean volume of the decoded Gaussians of a view."""
    return scaffold.volume_loss(frame.splats.scales)
