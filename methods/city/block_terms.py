"""What the training of a block minimises beside its photos, or in their place: depth, views from beside, appearance."""

import math
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.model import Model, Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.decoupled import DecoupledModel, appearance_loss
from splatproof.methods.priors.alignment import scaled_prior
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.prior_pixels import PriorPixels, require_prior
from splatproof.methods.training.schedules import require
from splatproof.methods.training.terms import Frame, ParameterTerm, Photometric, Term, mean_volume
from splatproof.reference.supervision.dense_initialisation import observations, points_of
from splatproof.reference.supervision.sideways_view import (
    inverse_depth_loss,
    sideways,
    sideways_loss,
)
from splatproof.reference.types.scene import Scene

DRAWN = 0.5
"""Alpha from which a pixel shows something that has a depth."""
LAST_DEPTH = 0.1
"""Share of its first weight that the depth term has at the last step (BlockGaussian: 1 to 0.1)."""
FIRST_SIDEWAYS = 0.02
"""Share of its last weight that the sideways term begins with (BlockGaussian: 0.01 to 0.5)."""
BEGIN = 1 / 8
"""Share of the steps after which the sideways term begins (BlockGaussian: 5,000 of 40,000)."""


@dataclass(frozen=True, kw_only=True)
class BlockTerms:
    """Weights of what a block minimises beside its photos, as BlockGaussian and StitchGS do; 0: no such term."""

    depth: float = 0.0
    """Weight, at the first step, of rendered inverse depth against the view's depth prior in units of the
    prior's median; it falls to a tenth (BlockGaussian: 1, in the unit of its scenes). Needs a depth prior."""
    sideways: float = 0.0
    """Weight, at the last step, of what the block shows 5 % of the image's width to the side of a photo, warped
    back into it and compared with it; it begins after an eighth of the steps with a fiftieth (BlockGaussian: 0.5)."""
    volume: float = 0.0
    """Weight of the mean volume of the block's Gaussians, in cubes of its extent (StitchGS: 0.01, in the unit of its
    scenes)."""
    appearance: bool = False
    """Whether a network learns what each photo did to the colours, which are compared in the photo's appearance
    then; it is dropped after training (VastGaussian). A block of one photo has none."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("depth", "sideways", "volume"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"block_terms.{name}", value, ">= 0")


NO_TERMS = BlockTerms()


def with_scaled_priors(scene: Scene) -> Scene:
    """The scene with its depth priors in the scale that sparse points say, where they are asked for.

    A prior that its view's points do not determine says nothing.

    Args:
        scene: With the tracks of its points.

    Raises: DataError if no training view has a depth prior.
    """
    require_prior(scene, "block_terms.depth")
    seen = observations(scene.points, len(scene.views))
    views = list(scene.views)
    for index in scene.train:
        if (load := views[index].load_prior) is not None:
            points = scene.points.positions[points_of(seen, index)]
            scaled = partial(scaled_prior, load, views[index].camera, points)
            views[index] = replace(views[index], load_prior=scaled)
    return replace(scene, views=tuple(views))


def block_terms(settings: BlockTerms, run: Run, extent: float) -> tuple[Term | ParameterTerm, ...]:
    """The terms that the settings ask for.

    Args:
        settings: Their weights.
        run: Backend and background of what is drawn from beside.
        extent: Size of the block in scene units.
    """
    made: list[Term | ParameterTerm] = []
    if settings.depth:
        made.append(depth_term(settings.depth))
    if settings.sideways:
        made.append(sideways_term(settings.sideways, run))
    if settings.volume:
        made.append(mean_volume(settings.volume, extent))
    return tuple(made)


def with_appearance(model: Model, plan: Plan, seed: int) -> tuple[Model, Plan]:
    """The model with a network of its photos' appearance, and the plan that compares colours in it.

    Args:
        model: What is trained.
        plan: Its training on photos.
        seed: Seed of network and embeddings.
    """
    shown = DecoupledModel(model, [view.name for view in plan.views], seed)
    terms = [appearance_loss(one) if isinstance(one, Photometric) else one for one in plan.terms]
    return shown, replace(plan, terms=tuple(terms))


def depth_term(weight: float) -> Term:
    """Rendered inverse depth against priors in the scene's scale; views without one have no such term.

    Args:
        weight: Factor at the first step.

    Source: BlockGaussian, its depth term, with the priors' scale fitted in another robust way.
    """
    priors = PriorPixels()

    def loss(frame: Frame) -> Float[Tensor, ""]:
        depth = frame.output.depth
        if (told := priors.of(frame)) is None:
            return depth.new_zeros(())
        prior, valid = told
        counts = valid & (frame.output.alpha.detach() > DRAWN)
        return depth_share(frame.moment) * inverse_depth_loss(depth, prior, counts)

    return Term(name="inverse depth", loss=loss, weight=weight)


def sideways_term(weight: float, run: Run) -> Term:
    """What the model shows from beside, warped back by the rendered depth, against the photo.

    Args:
        weight: Factor at the last step.
        run: Backend and background of what is drawn from beside.

    Source: BlockGaussian, its pseudo-view constraint, as intended.
    """
    backend = get_backend(run.backend)

    def loss(frame: Frame) -> Float[Tensor, ""]:
        depth, camera = frame.output.depth, frame.view.camera
        counts = frame.output.alpha.detach() > DRAWN
        if frame.mask is not None:
            counts = counts & frame.mask
        share = sideways_share(frame.moment)
        if not share or not bool(counts.any()):
            return depth.new_zeros(())
        beside = sideways(camera, depth[counts].median())
        there = replace(frame.view.without_truth(), camera=beside)
        output = backend.draw(
            beside, frame.model.splats(there, frame.moment), mode=frame.model.mode,
            background=torch.tensor(run.background).to(depth),
        )  # fmt: skip
        image = frame.model.finish_image(there, output)
        found = sideways_loss(image, beside, frame.truth, camera, depth, counts)
        return share * found.to(depth)

    return Term(name="sideways view", loss=loss, weight=weight)


def depth_share(moment: Moment) -> float:
    """Share of its first weight that the depth term has: from 1 to LAST_DEPTH, evenly in its logarithm.

    Args:
        moment: The step of training.
    """
    return LAST_DEPTH ** (moment.step / moment.total)


def sideways_share(moment: Moment) -> float:
    """Share of its last weight that the sideways term has: 0, then from FIRST_SIDEWAYS to 1 in the same way.

    Args:
        moment: The step of training.
    """
    done = (moment.step / moment.total - BEGIN) / (1 - BEGIN)
    return FIRST_SIDEWAYS ** (1 - done) if done > 0 else 0.0
