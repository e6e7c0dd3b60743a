"""Method fsgs: 3dgs for few views, unpooled between lonely Gaussians, depth correlated with a prior."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.method import Method
from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import explicit, exposed
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.sparse_views.density import SparseControl, SparseDensity
from splatproof.methods.sparse_views.nearest import nearest_others
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.cost import cost
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import initialise
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.prior_pixels import PriorPixels
from splatproof.methods.training.schedules import require, shrink
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.terms import Frame, Term
from splatproof.reference.sparse_views.depth_correlation import correlation_loss
from splatproof.reference.sparse_views.unpooling import unpooled
from splatproof.reference.types.scene import Scene

LATE, LATE_SHARE = 0.95, 0.02
"""After this share of the steps the depth's weight is this share of itself (the release: 0.001 of
0.05 from step 9,500 of 10,000)."""


@dataclass(frozen=True, kw_only=True)
class FsgsDensity(SparseDensity):
    """Density control of FSGS: that of its release, and unpooling."""

    unpool_stop: int = 6000
    """Step from which on nothing is unpooled (the release: 2,000 of 10,000). 0: nothing ever is, an
    ablation of the paper."""
    unpool_distance: float = 0.1
    """Mean distance to the 3 nearest Gaussians, as a share of the scene's extent, above which one is
    unpooled. The paper has a length without a unit. Chosen without training on made aerial scenes of a
    seed that no suite uses: it selects 1 to 9 % of the points triangulated from nine views, and a fifth
    and more of the few from three."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        require(self.unpool_stop >= 0, "density.unpool_stop", self.unpool_stop, ">= 0")
        distance = self.unpool_distance
        require(0 <= distance < math.inf, "density.unpool_distance", distance, ">= 0")


@dataclass(frozen=True, kw_only=True)
class Fsgs(Settings):
    """Method fsgs: 3dgs for few views. Steps are those of a 30,000 step run; the release's 10,000
    are stretched to it."""

    sh_interval: int = 1500
    """Steps after which each further SH degree is trained; 0: all from the start."""
    depth_weight: float = 0.05
    """Weight of the correlation of rendered depth with the view's depth prior; views that have none
    have no such term (the case's `depth_prior` gives them one). 0: no term, an ablation of the paper."""
    density: FsgsDensity = field(default_factory=FsgsDensity)
    """When and where Gaussians are added and removed."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        require(0 <= self.depth_weight < math.inf, "depth_weight", self.depth_weight, ">= 0")


class FsgsControl(SparseControl):
    """SparseControl that unpools after each early densification."""

    def __init__(self, settings: FsgsDensity, *, iterations: int, extent: float) -> None:
        """Start without statistics.

        Args:
            settings: Thresholds and steps of a 30,000 step run, shrunk to this one's.
            iterations: Steps of the run.
            extent: Size of the scene in scene units.
        """
        super().__init__(settings, iterations=iterations, extent=extent)
        self.unpool_stop = round(settings.unpool_stop * shrink(iterations))
        self.unpool_distance = settings.unpool_distance * extent

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Densify and unpool, then reset opacities, each where its step has come.

        Args:
            step: Number of the step, from 1; its update is done.
            parameters: The model's tensors, those of a GaussianModel.
            generator: Source of the children's positions.
        """
        if self.densifies(step):
            most = self.most_after(step, len(parameters))
            yield self.densify(step, parameters, generator, most=most)
            if step < self.unpool_stop:
                yield self.unpool(parameters, most)
        if self.resets(step):
            yield self.reset(parameters)

    def unpool(self, parameters: Parameters, most: int | None) -> Edit:
        """Add Gaussians half way between lonely ones and their neighbours.

        They have the neighbour's scale and opacity, no rotation, and are grey.

        Args:
            parameters: The model's tensors, those of a GaussianModel.
            most: Most Gaussians afterwards; None: no bound.
        """
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        made = unpooled(
            rows["means"], *nearest_others(rows["means"]), self.unpool_distance,
            None if most is None else most - len(parameters),
        )  # fmt: skip
        added = len(made.means)
        parents = torch.cat(
            [torch.arange(len(parameters)).to(made.destinations), made.destinations]
        )
        values = {name: rows[name][parents] for name in ("quaternions", "sh_dc", "sh_rest")}
        for value in values.values():
            value[len(parameters) :] = 0
        values["quaternions"][len(parameters) :, 0] = 1
        values["means"] = torch.cat([rows["means"], made.means])
        fresh = torch.arange(len(parents), device=parents.device) >= len(parents) - added
        return Edit(parents=parents, fresh=fresh, values=values)


def depth_term(weight: float) -> Term:
    """Correlation of rendered depth, not divided by alpha, with the view's depth prior.

    Args:
        weight: Factor on the term; it is 0.02 of itself in the last twentieth of the run.

    Source: Zhu et al. 2024, "FSGS", Eq. 6, and its release; without the release's pseudo views, whose
        depth a network says of each render.
    """
    priors = PriorPixels()

    def loss(frame: Frame) -> Float[Tensor, ""]:
        output = frame.output
        if (told := priors.of(frame)) is None:
            return output.depth.new_zeros(())
        prior, valid = told
        late = frame.moment.step > LATE * frame.moment.total
        share = LATE_SHARE if late else 1.0
        return share * correlation_loss(output.depth * output.alpha, prior, valid)

    return Term(name="depth correlation", loss=loss, weight=weight)


def fit(scene: Scene, settings: Fsgs, run: Run) -> ExplicitModel:
    """Train on scene.train_views and return the model.

    Args:
        scene: With sparse points and training views, which may have depth priors.
        settings: What is chosen about the method.
        run: Where checkpoints go; one that is there already is continued. Its record says of how
            many views depth was correlated.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; SplatproofError if the loss stops being finite.

    Source: Zhu et al. 2024, "FSGS: Real-Time Few-shot View Synthesis using Gaussian Splatting".
    """

    def prepared() -> tuple[Model, Plan]:
        model, plan = prepare(threedgs.started(scene, settings, run), settings, run)
        return exposed(model, settings.exposure, plan.views), plan

    used = sum(view.load_prior is not None for view in scene.train_views)
    used = used if settings.depth_weight else 0
    run.on_fact("depth correlated", f"{used} of {len(scene.train_views)} views")
    return explicit(train(run, prepared), scene, run.backend)


def prepare(scene: Scene, settings: Fsgs, run: Run) -> tuple[GaussianModel, Plan]:
    """The model at its start, and the plan of its training.

    Args:
        scene: With the points to start from.
        settings: What is chosen about the method.
        run: Seed, background and backend are part of the plan's key.

    Raises: DataError if there is no point or no training view.
    """
    model, plan = threedgs.prepare(scene, settings, run)
    terms = plan.terms
    if settings.depth_weight and any(view.load_prior for view in scene.train_views):
        terms = (*terms, depth_term(settings.depth_weight))
    density = FsgsControl(
        settings.density, iterations=settings.round_steps, extent=initialise.extent(scene)
    )
    key = run_key(scene, settings, run, scene.facts.get("depth_prior_sha256", ""))
    return model, replace(plan, terms=terms, density=density, key=key)


FSGS = Method(
    name="fsgs",
    settings=Fsgs,
    fit=fit,
    cost=cost,
    description="3dgs for few views: Gaussians added between those that stand far apart, rendered depth "
    "correlated with the case's depth prior (Zhu et al. 2024)",
)
