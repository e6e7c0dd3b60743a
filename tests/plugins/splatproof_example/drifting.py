"""Method drifting: Gaussians that each move along a straight line in time."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.contracts.method import Cost, Method
from splatproof.methods.contracts.model import Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.decoded import DecodedModel, loader
from splatproof.methods.models.gaussian_model import GaussianModel, assemble
from splatproof.methods.training.density import Density
from splatproof.methods.training.density_control import DensityControl
from splatproof.methods.training.initialise import extent, from_points
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import Rates, settling
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.terms import Photometric
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene, View
from splatproof.reference.types.splats import Splats

KIND = "drifting"


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What can be chosen about method drifting."""

    iterations: int = 1000
    """Training steps, one view each."""
    rate: float = 0.01
    """Learning rate of velocities, in scene units a second."""


class Drifting(GaussianModel):
    """Gaussians with a velocity each: mean(t) = mean + velocity * t."""

    def __init__(self, start: Gaussians, *, size: float, rate: float) -> None:
        """Start at rest.

        Args:
            start: Gaussians at time 0.
            size: Extent of the scene in scene units.
            rate: Learning rate of velocities.
        """
        super().__init__(start, Rates(), extent=size)
        self.parameters.rows["velocities"] = torch.zeros(len(start), 3)
        self.schedules["velocities"] = settling(rate, 0.1)
        self.size, self.rate = size, rate

    def splats(self, view: View, moment: Moment) -> Splats:
        """The Gaussians where they are at the view's time."""
        splats = super().splats(view, moment)
        moved = (view.time or 0.0) * self.parameters.rows["velocities"]
        return replace(splats, means=splats.means + moved)

    def facts(self) -> dict[str, Any]:
        """What `build` needs."""
        return {"degree": self.degree, "size": self.size, "rate": self.rate}


def fit(scene: Scene, settings: Settings, run: Run) -> DecodedModel:
    """Train on the scene's training views."""

    def prepare() -> tuple[Drifting, Plan]:
        size, steps = extent(scene), settings.iterations
        start = from_points(scene, degree=0, opacity=0.3)
        density = DensityControl(
            Density(
                start=1000, least_interval=20, reset_interval=0, most=len(start.means) * 3 // 2
            ),
            iterations=steps,
            extent=size,
        )
        return Drifting(start, size=size, rate=settings.rate), Plan(
            steps=steps, views=scene.train_views, terms=(Photometric(),), density=density,
            key=run_key(scene, settings, run),
        )  # fmt: skip

    return DecodedModel.of(KIND, train(run, prepare), scene, run.backend)


def build(facts: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> Drifting:
    """The model that was stored."""
    rows = {name.removeprefix("rows."): value for name, value in tensors.items()}
    start = assemble(rows, int(facts["degree"]))
    return Drifting(start, size=float(facts["size"]), rate=float(facts["rate"]))


def cost(settings: Settings, scene: Scene) -> Cost:
    """Ten microseconds a Gaussian and step."""
    count = len(scene.points)
    return Cost(cpu_seconds=1e-5 * count * settings.iterations, memory_mb=450 + count / 100)


METHOD = Method(
    name=KIND, settings=Settings, fit=fit, cost=cost, loaders={KIND: loader(KIND, build)},
    description="Gaussians that move along straight lines in time",
)  # fmt: skip
