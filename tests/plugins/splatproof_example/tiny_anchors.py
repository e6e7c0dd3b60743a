"""Method tiny-anchors: anchors decoded by small networks, with an exposure for each training photo."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Observation, Statistic
from splatproof.methods.contracts.method import Cost, Method
from splatproof.methods.contracts.model import Model, Moment
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.decoded import DecodedModel, loader
from splatproof.methods.training.initialise import extent, neighbour_distance
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import log_linear, settling
from splatproof.methods.training.session import run_key, train
from splatproof.methods.training.terms import Frame, Photometric, Term
from splatproof.reference.anchors import scaffold
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View
from splatproof.reference.types.splats import Splats

KIND = "tiny-anchors"
NETWORKS = ("opacity", "shape", "colour")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What can be chosen about method tiny-anchors."""

    iterations: int = 1000
    """Training steps, one view each."""
    gaussians: int = 4
    """Gaussians an anchor."""
    features: int = 8
    """Numbers of an anchor's feature."""
    volume: float = 0.01
    """Weight of the mean volume of the decoded Gaussians."""
    interval: int = 50
    """Steps between growing and pruning."""


class TinyAnchors(Model):
    """Anchors that never move; offsets, features and scales are trained, and three networks."""

    def __init__(self, parameters: Parameters, photos: list[str], size: float) -> None:
        """Take the tensors.

        Args:
            parameters: As `started` makes them.
            photos: Names of the training photos, in the order of their exposures.
            size: Extent of the scene in scene units.
        """
        shared = dict.fromkeys(parameters.shared, settling(4e-3, 0.1))
        super().__init__(
            parameters,
            {"offsets": log_linear(0.01, 1e-4, factor=size), "features": settling(7.5e-3),
             "log_scales": settling(7e-3)} | shared,
        )  # fmt: skip
        self.photos, self.size = photos, size

    def splats(self, view: View, moment: Moment) -> Splats:
        """What the anchors decode to for the view's camera."""
        rows, shared = self.parameters.rows, self.parameters.shared
        anchors = scaffold.Anchors(
            centres=self.parameters.labels["centres"], offsets=rows["offsets"],
            features=rows["features"], log_scales=rows["log_scales"],
        )  # fmt: skip
        networks = {
            name: Mlp(
                weights=tuple(shared[f"{name}.weight{i}"] for i in (0, 1)),
                biases=tuple(shared[f"{name}.bias{i}"] for i in (0, 1)),
            )
            for name in NETWORKS
        }
        return scaffold.decode(anchors, scaffold.Decoder(**networks), view.camera.centre)

    def finish_image(self, view: View, output: RenderOutput) -> Float[Tensor, "h w 3"]:
        """The colours times the exposure of the photo whose appearance is asked for."""
        name = view.appearance or view.name
        if not isinstance(name, str) or name not in self.photos:
            return output.colour  # exposures have mean 0: the neutral one
        gains = self.parameters.shared["exposures"]
        gain = gains[self.photos.index(name)] - gains.mean(dim=0)
        return output.colour * gain.exp()

    def facts(self) -> dict[str, Any]:
        """What `build` needs."""
        return {"photos": self.photos, "size": self.size}


class GrowAndPrune:
    """Anchors whose Gaussians stay transparent go; those that are pulled at hardest get a neighbour."""

    needs: frozenset[Statistic] = frozenset({"signed"})

    def __init__(self, settings: Settings) -> None:
        """Start without statistics."""
        self.settings = settings
        self.opacity = self.pull = self.visits = torch.zeros(0)

    def watches(self, step: int) -> bool:
        """In the first half."""
        return step <= self.settings.iterations // 2

    def observe(self, seen: Observation) -> None:
        """Sum opacities and gradients over the Gaussians of each anchor."""
        if len(self.visits) != seen.count:
            self.opacity, self.pull, self.visits = (torch.zeros(seen.count) for _ in range(3))
        assert seen.opacities is not None
        self.opacity += seen.by_row(seen.opacities)
        self.pull += seen.by_row(seen.gradient_norm("signed"))
        self.visits += 1

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Prune, then grow, every so many steps."""
        del generator
        if step % self.settings.interval or not self.watches(step):
            return
        keep = torch.where(self.opacity / self.visits >= 0.005)[0]
        if not len(keep):
            return
        hardest = keep[self.pull[keep].argsort(descending=True, stable=True)[: len(keep) // 10]]
        parents = torch.cat([keep, hardest])
        fresh = torch.arange(len(parents)) >= len(keep)
        centres = parameters.labels["centres"][parents]
        reach = parameters.rows["log_scales"].detach()[hardest, :3].exp()
        centres[fresh] += parameters.rows["offsets"].detach()[hardest, 0] * reach
        yield Edit(parents=parents, fresh=fresh, values={"centres": centres})
        self.opacity = self.pull = self.visits = torch.zeros(0)

    def state(self) -> dict[str, Tensor]:
        """The sums so far."""
        return {"opacity": self.opacity, "pull": self.pull, "visits": self.visits}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take them over."""
        self.opacity, self.pull, self.visits = (
            state[name].clone() for name in ("opacity", "pull", "visits")
        )


def started(scene: Scene, settings: Settings, seed: int) -> Parameters:
    """One anchor a sparse point, networks drawn at random."""
    generator = torch.Generator().manual_seed(seed)
    decoder = scaffold.create_decoder(settings.features, settings.gaussians, generator)
    count, k = len(scene.points), settings.gaussians
    apart = neighbour_distance(scene.points.positions, lone=0.01 * extent(scene)).float()
    shared = {"exposures": torch.zeros(len(scene.train), 3)}
    for name in NETWORKS:
        network: Mlp = getattr(decoder, name)
        for i in (0, 1):
            shared |= {
                f"{name}.weight{i}": network.weights[i], f"{name}.bias{i}": network.biases[i],
            }  # fmt: skip
    return Parameters(
        {
            "offsets": 0.1 * torch.randn(count, k, 3, generator=generator),
            "features": torch.randn(count, settings.features, generator=generator),
            "log_scales": apart.log()[:, None].repeat(1, 6),
        },
        shared=shared,
        labels={"centres": scene.points.positions.float()},
    )


def volume(frame: Frame) -> Float[Tensor, ""]:
    """Mean volume of the decoded Gaussians."""
    return scaffold.volume_loss(frame.splats.scales)


def fit(scene: Scene, settings: Settings, run: Run) -> DecodedModel:
    """Train on the scene's training views."""

    def prepare() -> tuple[TinyAnchors, Plan]:
        photos = [view.name for view in scene.train_views]
        model = TinyAnchors(started(scene, settings, run.seed), photos, extent(scene))
        return model, Plan(
            steps=settings.iterations, views=scene.train_views,
            terms=(Photometric(), Term(name="volume", loss=volume, weight=settings.volume)),
            density=GrowAndPrune(settings), key=run_key(scene, settings, run),
        )  # fmt: skip

    return DecodedModel.of(KIND, train(run, prepare), scene, run.backend)


def build(facts: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> TinyAnchors:
    """The model that was stored."""
    groups: dict[str, dict[str, Tensor]] = {"rows": {}, "shared": {}, "labels": {}}
    for name, value in tensors.items():
        group, _, rest = name.partition(".")
        groups[group][rest] = value
    parameters = Parameters(groups["rows"], shared=groups["shared"], labels=groups["labels"])
    return TinyAnchors(parameters, list(facts["photos"]), float(facts["size"]))


def cost(settings: Settings, scene: Scene) -> Cost:
    """Ten microseconds a Gaussian and step."""
    count = len(scene.points) * settings.gaussians
    return Cost(cpu_seconds=1e-5 * count * settings.iterations, memory_mb=450 + count / 100)


METHOD = Method(
    name=KIND, settings=Settings, fit=fit, cost=cost, loaders={KIND: loader(KIND, build)},
    description="Anchors decoded by small networks, an exposure for each training photo",
)  # fmt: skip
