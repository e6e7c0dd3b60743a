"""Train explicit Gaussians: 3D Gaussian Splatting on any rasterizer, resumable bit for bit."""

import hashlib
import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import torch
from torch import Tensor

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.datasets.image_cache import TensorCache
from splatproof.methods.backends import Backend, get_backend
from splatproof.methods.kernels.loss import photometric
from splatproof.methods.kernels.step import ViewGradients
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import initialise
from splatproof.methods.training.density import DensityControl, reset_opacity
from splatproof.methods.training.gradient_mean import GradientMean
from splatproof.methods.training.optimizer import Adam
from splatproof.methods.training.regularisers import draw_shown, opacity_pull, thinned
from splatproof.methods.training.schedules import active_degree, means_rate, settling, shrink
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene, View

REPORT_EVERY = 10
"""Steps between reports."""


def fit(scene: Scene, settings: Settings, run: Run) -> ExplicitModel:
    """Train on scene.train_views and return the model.

    The optimizer steps on every iteration, also on those that densify (in the release it does not).

    Args:
        scene: With sparse points and training views.
        settings: Of the row.
        run: Where checkpoints go; one that is there already is continued.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; SplatproofError if the loss stops being finite.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 5 and Alg. 1.
    """
    backend = get_backend(run.backend)
    with threads(run.threads):
        started = time.perf_counter()
        scene = initialise.with_points(scene, settings, run)
        trainer = Trainer(scene, settings, run, backend)
        trainer.resume()
        run.on_stage("init", time.perf_counter() - started)
        trainer.train()
        run.on_stage("train", trainer.seconds)
    return ExplicitModel(
        model=trainer.gaussians(), method="3dgs", settings=asdict(settings), shift=scene.shift,
        units=scene.units, backend=run.backend, mode=settings.mode,
    )  # fmt: skip


@contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Give torch `count` threads inside, and back what it had afterwards."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class Trainer:
    """The state of one run and the step that changes it."""

    renders_parameters = True
    """Whether `model` is the trained tensors and nothing else, so that the kernels can read them."""

    def __init__(
        self,
        scene: Scene,
        settings: Settings,
        run: Run,
        backend: Backend,
        *,
        start: Gaussians | None = None,
        special: str = "",
    ) -> None:
        """Start from the sparse points, or from `start`.

        Args:
            scene: As for `fit`.
            settings: As for `fit`.
            run: As for `fit`.
            backend: Rasterizer.
            start: Gaussians of settings.sh_degree to start from.
            special: What else the run depends on (a subclass's own); part of the checkpoint's key.
        """
        if start is None:
            start = initialise.from_points(
                scene, degree=settings.sh_degree, opacity=settings.initial_opacity
            )
        self.settings, self.run, self.backend = settings, run, backend
        self.views = scene.train_views
        self.images = TensorCache(run.image_bytes)
        self.extent = initialise.extent(scene)
        self.background = torch.tensor(run.background)
        self.gradients = ViewGradients()
        self.adam = Adam(
            {"means": start.means, "sh_dc": start.sh[:, :1], "sh_rest": start.sh[:, 1:],
             "opacity": start.opacity_logits, "scales": start.log_scales,
             "quaternions": start.quaternions}
        )  # fmt: skip
        self.control = DensityControl(
            settings.density, iterations=settings.iterations, extent=self.extent, count=len(start)
        )
        self.generator = torch.Generator().manual_seed(run.seed)
        self.order: list[int] = []
        self.step = 0
        self.seconds = 0.0
        self.key = json.dumps([scene.name, scene_digest(scene), asdict(settings), run.seed,
                               run.background, run.backend]
                              + ([special] if special else []))  # fmt: skip

    def gaussians(self) -> Gaussians:
        """The model as it is now, without gradients."""
        values = {name: value.detach() for name, value in self.adam.parameters.items()}
        return assemble(values, self.settings.sh_degree)

    def train(self) -> None:
        """Run all steps that are left, with reports and checkpoints."""
        clock = saved = time.perf_counter()
        while self.step < self.settings.iterations:
            loss = self.advance()
            now = time.perf_counter()
            self.seconds, clock = self.seconds + now - clock, now
            last = self.step == self.settings.iterations
            if last or self.step % REPORT_EVERY == 0:
                count = float(len(self.adam.parameters["means"]))
                values = {"loss": loss, "gaussians": count}
                self.run.report(self.step, self.settings.iterations, values)
            if last or now - saved >= self.run.checkpoint_seconds:
                self.save()
                clock = saved = time.perf_counter()

    def advance(self) -> float:
        """One step: render views, follow the loss's gradient, control the density."""
        self.step += 1
        mean, losses = GradientMean(), []
        for _ in range(self.settings.views_per_step):
            view = self.views[self.next_view()]
            loss, screen, radii = self.backward(view)
            losses.append(loss)
            if self.control.watches(self.step):
                self.control.observe(screen, radii, view.camera)
            if self.settings.views_per_step > 1:
                mean.take(self.adam.parameters)
        mean.leave(self.adam.parameters)
        self.update()
        if self.control.densifies(self.step):
            self.densify()
        if self.control.resets(self.step):
            self.reset()
        return sum(losses) / len(losses)

    def update(self) -> None:
        """Follow the gradients that `backward` left."""
        self.adam.step(self.learning_rates())

    def densify(self, fixed: Tensor | None = None) -> Tensor:
        """Clone, split and prune; `fixed` rows stay as they are. Returns each new row's old row."""
        rows = self.control.step(self.step, self.gaussians(), self.generator, fixed)
        self.adam.gather(rows.parents, rows.fresh)
        self.adam.overwrite("means", rows.means, forget=False)
        self.adam.overwrite("scales", rows.log_scales, forget=False)
        return rows.parents

    def reset(self) -> None:
        """Make everything nearly transparent."""
        logits = reset_opacity(self.adam.parameters["opacity"].detach())
        self.adam.overwrite("opacity", logits, forget=True)

    def state(self) -> dict[str, Tensor]:
        """What a subclass adds to the checkpoint."""
        return {}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` returned; self.step is set already."""

    def model(self, degree: int) -> Gaussians:
        """The Gaussians that are rendered and differentiated."""
        return assemble(self.adam.leaves(), degree)

    def backward(self, view: View) -> tuple[float, Tensor, Tensor]:
        """Render one view and leave its loss's gradients in the parameters.

        Returns: The loss, its gradient by the 2D means and the radii, valid until the next step.
        """
        every = self.settings.sh_interval * shrink(self.settings.iterations)
        degree = active_degree(self.step, every, self.settings.sh_degree)
        truth = self.images.get((view.name, "image"), view.load)
        mask = view.load_mask and self.images.get((view.name, "mask"), view.load_mask)
        native = self.backend.name == "cpu" and self.renders_parameters
        differentiate = self.by_kernels if native else self.by_autograd
        loss, screen, radii = differentiate(view.camera, degree, truth, mask)
        if not math.isfinite(loss):
            raise SplatproofError(
                f"step {self.step}, view {view.name}: the loss is {loss}; lower the learning rates"
            )
        if self.settings.opacity_weight:
            opacity = self.adam.parameters["opacity"]
            if opacity.grad is not None:
                opacity.grad += opacity_pull(opacity.detach(), self.settings.opacity_weight)
        return loss, screen, radii

    def by_kernels(
        self, camera: Camera, degree: int, truth: Tensor, mask: Tensor | None
    ) -> tuple[float, Tensor, Tensor]:
        """`backward` without a graph."""
        own = self.adam.parameters["opacity"].detach().requires_grad_()
        drawn = self.thin(own)
        step = self.gradients.of(
            camera, self.adam.parameters | {"opacity": drawn}, truth, degree=degree,
            background=self.behind(), mask=mask, dssim=self.settings.dssim, mode=self.settings.mode,
        )  # fmt: skip
        for name, gradient in step.gradients.items():
            self.adam.parameters[name].grad = gradient
        if drawn is not own:
            pull = torch.autograd.grad(drawn, own, step.gradients["opacity"])[0]
            self.adam.parameters["opacity"].grad = pull
        return step.loss, step.screen, step.radii

    def by_autograd(
        self, camera: Camera, degree: int, truth: Tensor, mask: Tensor | None
    ) -> tuple[float, Tensor, Tensor]:
        """`backward` on any backend."""
        model = self.model(degree)
        model = replace(model, opacity_logits=self.thin(model.opacity_logits))
        probe = ScreenProbe.zeros(len(model), model.means)
        image = self.backend.rasterize(
            camera, model.means, model.quaternions, model.scales, model.opacities, sh=model.sh,
            background=self.behind(), probe=probe, mode=self.settings.mode,
        )  # fmt: skip
        loss = photometric(image.colour, truth, dssim=self.settings.dssim, mask=mask)
        loss.backward()
        assert probe.signed.grad is not None
        return float(loss.detach()), probe.signed.grad, image.radii

    def thin(self, logits: Tensor) -> Tensor:
        """The opacity logits that one step draws."""
        share = self.settings.dropout * self.step / self.settings.iterations
        if share == 0:
            return logits
        return thinned(logits, draw_shown(len(logits), share, self.generator), share)

    def behind(self) -> Tensor:
        """The background of one step."""
        if self.settings.random_background:
            return torch.rand(3, generator=self.generator)
        return self.background

    def next_view(self) -> int:
        """Views come in random order without replacement, epoch after epoch."""
        if not self.order:
            self.order = torch.randperm(len(self.views), generator=self.generator).tolist()
        return self.order.pop()

    def learning_rates(self) -> dict[str, float]:
        """Adam's rate of each tensor at this step."""
        rates, total = self.settings.rates, self.settings.iterations
        factor = settling(rates, self.step, total)
        return {
            "means": means_rate(rates, self.step, total) * self.extent,
            "sh_dc": rates.sh_dc * factor,
            "sh_rest": rates.sh_rest * factor,
            "opacity": rates.opacity * factor,
            "scales": rates.scales * factor,
            "quaternions": rates.quaternions * factor,
        }

    @property
    def checkpoint(self) -> Path | None:
        """The file that a killed run is continued from."""
        folder = self.run.folder
        return None if folder is None else folder / "checkpoint" / "training.safetensors"

    def save(self) -> None:
        """Write everything that the next step depends on."""
        if self.checkpoint is None:
            return
        tensors = {f"adam.{name}": value for name, value in self.adam.state().items()}
        tensors |= {f"density.{name}": value for name, value in self.control.state().items()}
        tensors |= {f"special.{name}": value for name, value in self.state().items()}
        tensors["generator"] = self.generator.get_state()
        facts = {"key": self.key, "step": self.step, "order": self.order, "seconds": self.seconds}
        write_tensors(self.checkpoint, tensors, facts)

    def resume(self) -> None:
        """Continue from the checkpoint, if there is one.

        Raises: UsageError if it belongs to another scene, settings, seed, background or backend.
        """
        if self.checkpoint is None or not self.checkpoint.exists():
            return
        tensors, facts = read_tensors(self.checkpoint)
        if not isinstance(facts, dict) or facts.get("key") != self.key:
            raise UsageError(
                f"{self.checkpoint}: belongs to a run with another scene, settings, seed, "
                "background or backend; remove it or choose another folder"
            )
        self.adam.restore(part(tensors, "adam."))
        self.control.restore(part(tensors, "density."))
        self.generator.set_state(tensors["generator"])
        self.step, self.order, self.seconds = facts["step"], facts["order"], facts["seconds"]
        self.restore(part(tensors, "special."))


def assemble(values: dict[str, Tensor], degree: int) -> Gaussians:
    """Gaussians of the trained tensors, with the SH bands up to `degree`."""
    rest = values["sh_rest"][:, : (degree + 1) ** 2 - 1]
    return Gaussians(
        means=values["means"], quaternions=values["quaternions"], log_scales=values["scales"],
        opacity_logits=values["opacity"], sh=torch.cat([values["sh_dc"], rest], dim=1),
    )  # fmt: skip


def part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names start with `prefix`, without it."""
    return {
        name.removeprefix(prefix): tensor
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }


def scene_digest(scene: Scene) -> str:
    """Hash of the training views' names and cameras and of the sparse points."""
    digest = hashlib.sha256()
    for view in scene.train_views:
        camera = view.camera
        digest.update(f"{view.name} {camera.width} {camera.height}".encode())
        digest.update(camera.K.numpy().tobytes() + camera.world_to_camera.numpy().tobytes())
    digest.update(scene.points.positions.numpy().tobytes())
    digest.update(scene.points.colours.numpy().tobytes())
    return digest.hexdigest()
