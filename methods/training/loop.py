"""The one training loop: any model, any terms, any density control, resumable bit for bit."""

import math
import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.density_strategy import Observation
from splatproof.methods.contracts.model import Model, Moment, NativeTensors
from splatproof.methods.contracts.run import Run
from splatproof.methods.kernels.step import ViewGradients
from splatproof.methods.kernels.threads import lent
from splatproof.methods.training.ahead import Ahead
from splatproof.methods.training.counts import Counts
from splatproof.methods.training.image_room import image_room
from splatproof.methods.training.optimizer import GradientMean
from splatproof.methods.training.photo_cache import PhotoCache
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.resolution import Resolution, shrunk
from splatproof.methods.training.run_keys import what_differs
from splatproof.methods.training.schedules import round_of
from splatproof.methods.training.shape_bounds import EVERY, shape_bounds
from splatproof.methods.training.terms import Frame, ParameterTerm, Photometric
from splatproof.methods.training.view_order import Shuffled
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.types.scene import View

REPORT_EVERY = 10
"""Steps between reports."""


class Trainer:
    """The state of one run and the step that changes it."""

    def __init__(self, model: Model, plan: Plan, run: Run) -> None:
        """Start at step 0.

        Args:
            model: What is trained; it is moved to the run's device.
            plan: What is minimised, on which views, and how the model changes.
            run: Seed, backend, checkpoints and who is told.

        Raises: ValueError if two terms have one name; UsageError if photos are to be shrunk for a
            method that compares more than photos.
        """
        names = [term.name for term in plan.terms]
        if len(set(names)) < len(names):
            raise ValueError(f"two terms have one name: {', '.join(names)}")
        self.model, self.plan, self.run = model, plan, run
        self.backend = get_backend(run.backend)
        self.device = torch.device(run.device or self.backend.device)
        model.parameters.to(self.device)
        self.optimizer = plan.optimizer(model.parameters)
        self.image_terms = [t for t in plan.terms if not isinstance(t, ParameterTerm)]
        self.parameter_terms = [t for t in plan.terms if isinstance(t, ParameterTerm)]
        if plan.resolution.levels and len(self.image_terms) > 1:
            raise UsageError(
                f"setting resolution.coarsest is {plan.resolution.coarsest}, expected 1: this method "
                "compares more than photos, which have one size"
            )
        self.room = image_room(run.image_bytes, plan.views)
        self.images = PhotoCache(self.room, plan.views)
        self.background = torch.tensor(run.background, device=self.device)
        self.gradients = ViewGradients()
        self.order = plan.order or Shuffled(len(plan.views))
        self.generator = torch.Generator().manual_seed(run.seed)
        self.step = 0
        self.seconds = self.cpu_seconds = 0.0
        self.counts = Counts()
        self.bounds = shape_bounds(plan.shapes, plan.views, model.parameters)
        self.native = self._can_be_native()
        self.ahead: Ahead | None = None

    def _can_be_native(self) -> bool:
        """Whether the kernels' step computes exactly what this plan asks for."""
        (*others, last) = self.image_terms or [None]
        return (
            self.plan.native
            and self.backend.name == "cpu"
            and not others
            and isinstance(last, Photometric)
            and last.weight == 1.0
            and not self.model.finishes
        )

    @property
    def path(self) -> str:
        """What computes the gradients: "kernels" or "autograd"."""
        if not self.native:
            return "autograd"
        moment = Moment(step=1, total=self.plan.steps)
        return "kernels" if self.model.native(self.plan.views[0], moment) else "autograd"

    def train(self) -> None:
        """Run all steps that are left, with reports and checkpoints; photos are read ahead."""
        room = self.images.passing if self.room.ahead else 0
        with closing(Ahead(lambda view: self.photo(self.sized(view)), room)) as self.ahead:
            self._train()

    def _train(self) -> None:
        clock = saved = time.perf_counter()
        spent = time.process_time()
        while self.step < self.plan.steps:
            values = self.advance()
            now, used = time.perf_counter(), time.process_time()
            self.seconds, clock = self.seconds + now - clock, now
            self.cpu_seconds, spent = self.cpu_seconds + used - spent, used
            if self.plan.recount and (steps := self.plan.recount(self.step, self.seconds)):
                self.recounted(steps)
            last = self.step == self.plan.steps
            if last or self.step % REPORT_EVERY == 0:
                told = values | {"gaussians": float(self.model.primitives)}
                self.run.report(self.step, self.plan.steps, told)
                self.run.on_model(self.step, self.plan.steps, self.model)
            if last or now - saved >= self.run.checkpoint_seconds:
                self.save()
                clock = saved = time.perf_counter()
                spent = time.process_time()

    def recounted(self, steps: int) -> None:
        """Go on to another number of steps, with photos of the size that they have reached.

        Larger ones would take longer than the steps by whose speed the number was told.

        Args:
            steps: Steps of the whole training, those that are done included.
        """
        reached = min(self.step, self.plan.steps)
        factor = self.plan.resolution.factor(reached, self.plan.steps)
        kept = Resolution(coarsest=factor, full_from=1.0)
        self.plan = replace(self.plan, steps=max(steps, self.step), resolution=kept)

    def advance(self) -> dict[str, float]:
        """One step: render views, follow the loss's gradient, control the density.

        Returns: The loss of the image terms, mean over the views, and each term by its name.
        """
        with lent():
            return self._advance()

    def _advance(self) -> dict[str, float]:
        self.step += 1
        self.images.resize(self.plan.resolution.factor(self.step, self.plan.steps))
        before = self.backend.pairs()
        mean, told = GradientMean(), []
        for _ in range(self.plan.views_per_step):
            view = self.plan.views[self.order.next(self.generator)]
            if self.ahead:
                self.ahead.look(view, (self.plan.views[index] for index in self.order.coming()))
            values, seen = self.backward(view)
            told.append(values)
            if seen is not None:
                self.plan.density.observe(seen)
            if self.plan.views_per_step > 1:
                mean.take(self.model.parameters.trained)
        mean.leave(self.model.parameters.trained)
        self.update()
        edits = self.plan.density.edits(self.turn[0], self.model.parameters, self.generator)
        self.counts = self.counts.after_step(self.backend.pairs() - before)
        for edit in edits:
            self.counts = self.counts.after_edit(edit, len(self.model.parameters))
            self.model.parameters.edit(edit)
            self.optimizer.edit(edit)
        return {name: sum(each[name] for each in told) / len(told) for name in told[0]}

    @property
    def turn(self) -> tuple[int, int]:
        """Number of this step in its round, from 1, and steps of the round."""
        return round_of(self.step, self.plan.steps, self.plan.restarts)

    def update(self) -> None:
        """Follow the gradients that `backward` left; what is held keeps its values."""
        rows = self.model.parameters.rows
        held = self.plan.held(self.model.parameters) if self.plan.held else {}
        kept = {name: rows[name].detach()[index] for name, index in held.items()}
        if self.step - 1 in self.plan.restarts:
            self.optimizer.restart()
        self.optimizer.step(self.rates())
        for bound in self.bounds if self.step % EVERY == 0 else ():
            bound.apply(self.model.parameters)
        for name, values in kept.items():
            rows[name].detach()[held[name]] = values

    def rates(self) -> dict[str, float]:
        """Rate of each tensor that is not frozen, at this step."""
        step, total = self.turn
        return {name: rate(step, total) for name, rate in self.model.schedules.items()}

    def backward(self, view: View) -> tuple[dict[str, float], Observation | None]:
        """Render one view and leave its loss's gradients in the parameters.

        Args:
            view: One to train on.

        Returns: The loss and each term by its name; what density control is told, valid until the
            next call, None where it does not watch this step.
        """
        view = self.sized(view)
        truth, mask = self.photo(view), None
        if load_mask := view.load_mask:
            mask = self.images.get(
                (view.name, view.size, "mask"), lambda: load_mask().to(self.device)
            )
        moment = Moment(step=self.step, total=self.plan.steps, generator=self.generator)
        native = self.model.native(view, moment) if self.native else None
        if native is not None:
            values, seen = self.by_kernels(view, native, truth, mask)
        else:
            values, seen = self.by_autograd(view, moment, truth, mask)
        if not math.isfinite(values["loss"]):
            raise SplatproofError(
                f"step {self.step}, view {view.name}: the loss is {values['loss']}; lower the "
                "learning rates"
            )
        for term in self.parameter_terms:
            values[term.name] = term.add(self.model.parameters)
        return values, seen

    def sized(self, view: View) -> View:
        """The view as large as this step takes it.

        Args:
            view: One to train on.
        """
        factor = self.plan.resolution.factor(self.step, self.plan.steps)
        if factor == 1:
            return view
        small = shrunk(replace(view, load=lambda: self.photo(view).cpu()), factor)
        return view if small.size == view.size else small

    def photo(self, view: View) -> Tensor:
        """A view's photo on the device, from memory where it is kept; not to be written into.

        Args:
            view: One to train on, of any size.
        """
        return self.images.get((view.name, view.size, "image"), lambda: view.load().to(self.device))

    def by_kernels(
        self, view: View, native: NativeTensors, truth: Tensor, mask: Tensor | None
    ) -> tuple[dict[str, float], Observation | None]:
        """`backward` without a graph.

        Args:
            view: What is rendered.
            native: The raw tensors.
            truth: The photo.
            mask: Pixels that count; None: all.
        """
        (term,) = self.image_terms
        assert isinstance(term, Photometric)
        watched = self.plan.density.watches(self.turn[0])
        step = self.gradients.of(
            view.camera, native.tensors, truth, degree=native.degree, background=self.behind(),
            mask=mask, dssim=term.dssim, mode=self.model.mode,
            absolute=watched and "absolute" in self.plan.density.needs,
        )  # fmt: skip
        native.leave(step.gradients)
        values = {"loss": step.loss, term.name: step.loss}
        if not watched:
            return values, None
        return values, Observation(
            camera=view.camera, radii=step.radii, opacities=None, signed=step.screen,
            absolute=step.absolute, rows=None, slots=None, count=len(self.model.parameters),
        )  # fmt: skip

    def by_autograd(
        self, view: View, moment: Moment, truth: Tensor, mask: Tensor | None
    ) -> tuple[dict[str, float], Observation | None]:
        """`backward` for any model, terms and backend.

        Args:
            view: What is rendered.
            moment: This step.
            truth: The photo.
            mask: Pixels that count; None: all.
        """
        for name, value in self.model.parameters.trained.items():
            value.requires_grad_(name in self.model.schedules)
        splats = self.model.splats(view.without_truth(), moment)
        probe, density = None, self.plan.density
        if density.watches(self.turn[0]):
            wanted = "absolute" in density.needs
            probe = ScreenProbe.zeros(len(splats), splats.means, absolute=wanted)
        output = self.backend.draw(
            view.camera, splats, background=self.behind(), probe=probe, mode=self.model.mode
        )
        frame = Frame(
            view=view, moment=moment, splats=splats, output=output,
            image=self.model.finish_image(view.without_truth(), output), truth=truth, mask=mask,
            model=self.model,
        )  # fmt: skip
        losses = {term.name: _weighted(term.weight, term.loss(frame)) for term in self.image_terms}
        loss = sum(losses.values(), start=truth.new_zeros(()))
        if loss.requires_grad:  # a view that shows nothing of the model says nothing about it
            loss.backward()
        values = {"loss": float(loss.detach())}
        values |= {name: float(value.detach()) for name, value in losses.items()}
        if probe is None:
            return values, None
        signed, absolute = (
            torch.zeros_like(part) if part.grad is None and part.requires_grad else part.grad
            for part in (probe.signed, probe.absolute)
        )
        return values, Observation(
            camera=view.camera, radii=output.radii, opacities=splats.opacities.detach(),
            signed=signed, absolute=absolute, rows=splats.rows, slots=splats.slots,
            decoded=splats.decoded, count=len(self.model.parameters),
        )  # fmt: skip

    def behind(self) -> Tensor:
        """The background of one view of a step."""
        if self.plan.random_background:
            return torch.rand(3, generator=self.generator).to(self.device)
        return self.background

    @property
    def checkpoint(self) -> Path | None:
        """The file that a killed run is continued from."""
        folder = self.run.folder
        return None if folder is None else folder / "checkpoint" / "training.safetensors"

    def save(self) -> None:
        """Write everything that the next step depends on."""
        if self.checkpoint is None:
            return
        groups = {
            "parameters": self.model.parameters.state(),
            "optimizer": self.optimizer.state(),
            "density": self.plan.density.state(),
        }
        tensors = {
            f"{group}.{name}": value.cpu()
            for group, state in groups.items()
            for name, value in state.items()
        }
        tensors["generator"] = self.generator.get_state()
        facts = {"key": self.plan.key, "step": self.step, "order": self.order.state(),
                 "seconds": self.seconds, "cpu_seconds": self.cpu_seconds,
                 "counts": self.counts.named(), "steps": self.plan.steps}  # fmt: skip
        write_tensors(self.checkpoint, tensors, facts)

    def resume(self) -> None:
        """Continue from the checkpoint, if there is one.

        Raises: UsageError if it belongs to another scene, settings, seed, background or backend, or
            an earlier release wrote it.
        """
        if self.checkpoint is None or not self.checkpoint.exists():
            return
        tensors, facts = read_tensors(self.checkpoint)
        if not isinstance(facts, dict) or facts.get("key") != self.plan.key:
            raise UsageError(
                f"{self.checkpoint}: belongs to a run that differs: "
                f"{what_differs(dict(facts or {}).get('key'), self.plan.key)}; remove it or choose "
                "another folder"
            )
        if "counts" not in facts:
            raise UsageError(
                f"{self.checkpoint}: an earlier release wrote it, which counted no work; remove it, "
                "or finish the run with that release"
            )
        self.model.parameters.restore(_part(tensors, "parameters."))
        self.optimizer.restore(_part(tensors, "optimizer."))
        counted = _part(tensors, "density.")
        self.plan.density.restore({n: value.to(self.device) for n, value in counted.items()})
        self.generator.set_state(tensors["generator"])
        self.step, self.seconds = facts["step"], facts["seconds"]
        self.cpu_seconds = facts.get("cpu_seconds", 0.0)  # older checkpoints do not know it
        self.counts = Counts(**facts["counts"])
        self.order.restore(facts["order"], self.step * self.plan.views_per_step)
        if facts.get("steps", self.plan.steps) != self.plan.steps:
            self.recounted(facts["steps"])


def _weighted(weight: float, loss: Tensor) -> Tensor:
    return loss if weight == 1.0 else weight * loss


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names start with `prefix`, without it."""
    return {
        name.removeprefix(prefix): tensor
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }
