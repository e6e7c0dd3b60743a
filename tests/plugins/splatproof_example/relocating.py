"""Method relocating: as many Gaussians as points, the faintest moved to where the images are wrong."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Observation, Statistic
from splatproof.methods.contracts.method import Cost, Method
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.training.initialise import extent, from_points
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import Rates
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.terms import Photometric
from splatproof.reference.rasterizer.rotation import rotation_matrix
from splatproof.reference.types.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What can be chosen about method relocating."""

    iterations: int = 1000
    """Training steps, one view each."""
    interval: int = 50
    """Steps between relocations."""
    share: float = 0.05
    """Share of the Gaussians that are moved each time, the faintest first."""


class Relocate:
    """Moves the faintest Gaussians to those that the loss pulls at hardest; their number stays."""

    needs: frozenset[Statistic] = frozenset({"absolute"})

    def __init__(self, settings: Settings) -> None:
        """Start without statistics."""
        self.settings = settings
        self.pull = torch.zeros(0)

    def watches(self, step: int) -> bool:
        """Always but at the end, where what was moved could not settle."""
        return step < 0.8 * self.settings.iterations

    def observe(self, seen: Observation) -> None:
        """Add up how hard each row is pulled at."""
        if len(self.pull) != seen.count:
            self.pull = torch.zeros(seen.count)
        self.pull += seen.by_row(seen.gradient_norm("absolute"))

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """One relocation every so many steps."""
        if step % self.settings.interval or not self.watches(step):
            return
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        count = max(1, round(self.settings.share * len(parameters)))
        faint = rows["opacity_logits"].argsort(stable=True)[:count]
        donors = self.pull.argsort(descending=True, stable=True)[:count]
        parents = torch.arange(len(parameters))
        parents[faint] = donors
        fresh = torch.zeros(len(parameters), dtype=torch.bool)
        fresh[faint] = True
        means, log_scales = rows["means"][parents], rows["log_scales"][parents]
        local = log_scales[faint].exp() * torch.randn(count, 3, generator=generator)
        turned = rotation_matrix(rows["quaternions"][donors]) @ local[:, :, None]
        means[faint] += turned[:, :, 0]
        self.pull = torch.zeros(len(parameters))
        yield Edit(parents=parents, fresh=fresh, values={"means": means, "log_scales": log_scales})

    def state(self) -> dict[str, Tensor]:
        """The sums so far."""
        return {"pull": self.pull}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take them over."""
        self.pull = state["pull"].clone()


def fit(scene: Scene, settings: Settings, run: Run) -> ExplicitModel:
    """Train on the scene's training views."""

    def prepare() -> tuple[GaussianModel, Plan]:
        start = from_points(scene, degree=1, opacity=0.3)
        model = GaussianModel(start, Rates(), extent=extent(scene))
        return model, Plan(
            steps=settings.iterations, views=scene.train_views, terms=(Photometric(),),
            density=Relocate(settings), key=run_key(scene, settings, run),
        )  # fmt: skip

    model = train(run, prepare)
    return ExplicitModel(
        model=model.gaussians(), shift=scene.shift, units=scene.units, backend=run.backend
    )


def cost(settings: Settings, scene: Scene) -> Cost:
    """A microsecond a Gaussian and step; memory of the process and of the Gaussians."""
    count = len(scene.points)
    return Cost(cpu_seconds=1e-6 * count * settings.iterations, memory_mb=450 + count / 500)


METHOD = Method(
    name="relocating", settings=Settings, fit=fit, cost=cost,
    description="Explicit Gaussians whose number never changes",
)  # fmt: skip
