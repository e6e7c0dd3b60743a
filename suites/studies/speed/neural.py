"""Whole training steps of the methods with networks, and of what they are held against, side by side."""

import math
import os
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.model import TRAINED
from splatproof.methods.kernels.networks import by_torch
from splatproof.methods.training.loop import Trainer
from splatproof.reference.checks.agreement import compare_gradients, largest_error
from splatproof.suites.hard_cases import steps
from splatproof.suites.studies.speed import neural_starts as starts
from splatproof.suites.studies.speed import stages
from splatproof.suites.studies.speed.neural_starts import STEP, Size

COMPONENT = "neural step"
"""Name of the rows' component."""
TORCH = " by torch"
"""What the name of a method ends in whose networks torch computes."""
STAGE_STEPS = 9
"""Steps that shares of stages are the medians of; in the reduced form a third of them."""
COSINE = 0.9999
"""Least cosine of gradients by the kernels' networks and by torch's, as for twins: 1 - 1e-8 was measured."""
FLOOR = 1e-6
"""Share of the largest gradient's norm below which another one is rounding, as for hard cases."""


@dataclass(frozen=True, kw_only=True)
class Goal:
    """What a step is to keep to on two quiet cores, at 100,000 Gaussians and 400x300."""

    ms: float | None = None
    ratio: float | None = None
    """In steps of the usual method."""

    @property
    def words(self) -> str:
        """As pages show it."""
        return f"{self.ms:g} ms" if self.ms else f"{self.ratio:g} x" if self.ratio else ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Methods that take turns on one scene."""

    kind: str
    """What they train on."""
    size: Size
    usual: str
    """The method that ratios are by."""
    start: Callable[[Size], Mapping[str, Trainer]]
    """Trainers by method, in the middle of their training."""
    quick: bool = False
    """Whether it is the reduced form's."""

    @property
    def label(self) -> str:
        """E.g. anchors, 100000 Gaussians 400x300."""
        size = self.size
        return f"{self.kind}, {size.gaussians} Gaussians {size.width}x{size.height}"


def anchors(size: Size) -> dict[str, Trainer]:
    """The methods of voxel anchors.

    Args:
        size: What is drawn.
    """
    return {"scaffold-gs": starts.scaffold_gs(size), "dlg-gs": starts.dlg(size)}


def drive(size: Size) -> dict[str, Trainer]:
    """The methods of drives.

    Args:
        size: What is drawn.
    """
    return dict(zip(("pvg", "hdgs"), starts.moving(size), strict=True))


FULL = Size(gaussians=100_000, width=400, height=300)
SMALL = Size(gaussians=2_000, width=100, height=75)
CASES = tuple(
    Case(kind=kind, size=size, usual=usual, start=start, quick=size is SMALL)
    for size in (FULL, SMALL)
    for kind, usual, start in (("anchors", "scaffold-gs", anchors), ("drive", "pvg", drive))
)
"""All cases; the reduced form has the small ones, and the full form the others."""
GOALS = {
    "scaffold-gs": Goal(ms=40.0), "dlg-gs": Goal(ratio=4.0), "hdgs": Goal(ratio=2.0)
}  # fmt: skip
BY_TORCH = ("scaffold-gs", "dlg-gs", "hdgs")
"""Methods whose networks torch can compute too."""


class Steps:
    """A session (suites/studies/speed/session.py) in this process whose runs are training steps of one method."""

    def __init__(self, trainer: Trainer, *, torch_networks: bool) -> None:
        """Keep the state that every turn begins with.

        Args:
            trainer: In the middle of its training.
            torch_networks: Whether torch computes the networks.
        """
        self.trainer, self.networks = trainer, by_torch if torch_networks else nullcontext
        self.pid = os.getpid()
        self.kept = [
            {name: value.clone() for name, value in part.state().items()} for part in self._parts()
        ]

    def _parts(self) -> tuple[Any, ...]:
        return self.trainer.model.parameters, self.trainer.optimizer, self.trainer.plan.density

    def restored(self) -> Trainer:
        """The trainer with parameters, moments and statistics as at first; views and draws go on."""
        for part, state in zip(self._parts(), self.kept, strict=True):
            part.restore(state)
        self.trainer.step = STEP
        return self.trainer

    def ask(self, *request: Any) -> Any:
        """Answer "turn" seconds: milliseconds of each step, at least one; one before them is not counted.

        Args:
            request: The word, and for how long.
        """
        _, seconds = request
        trainer, runs = self.restored(), []
        with self.networks():
            trainer.advance()
            end = time.perf_counter() + seconds
            while not runs or time.perf_counter() < end:
                begin = time.perf_counter()
                trainer.advance()
                runs.append((1e3 * (time.perf_counter() - begin), math.nan))
        return runs

    def close(self) -> None:
        """Nothing to end."""


def sessions(case: Case) -> dict[str, Steps]:
    """The methods of a case and, where they have networks, each once more with torch's.

    Args:
        case: Which.
    """
    made: dict[str, Steps] = {}
    for method, trainer in case.start(case.size).items():
        made[method] = Steps(trainer, torch_networks=False)
        if method in BY_TORCH:
            made[method + TORCH] = Steps(trainer, torch_networks=True)
    return made


def facts(name: str, session: Steps, *, quick: bool) -> dict[str, Any]:
    """What a row says beside times.

    Keys: gaussians (visible in a view, mean), max_abs_error, grad_rel_l2, grad_cosine (of a view's image and of the
    worst tensor's gradient, kernels against torch; None for methods without networks, and for torch itself),
    exact_loss_error, exact_grad_rel_l2 (of a step on the nasty scene, against float64 and autograd), ok (whether the
    latter keep their budget and gradients of the kernels point where torch's do), stages (shares of a step by name), goal.

    Args:
        name: Method, or method by torch.
        session: Its steps.
        quick: Whether few steps are enough.
    """
    method = name.removesuffix(TORCH)
    with session.networks():
        exact = steps.judge(method, steps.RUNGS[0])
    found: dict[str, float | None] = dict.fromkeys(("max_abs_error", "grad_rel_l2", "grad_cosine"))
    trainer = session.restored()
    if name in BY_TORCH:
        found |= errors(trainer)
    cosine, seen = found["grad_cosine"], visible(trainer)
    with session.networks():
        parts = stages.shares(trainer, max(1, STAGE_STEPS // (3 if quick else 1)))
    goal = GOALS.get(name, Goal()).words
    return {
        **found, "exact_loss_error": exact["max_abs_error"], "exact_grad_rel_l2": exact["grad_rel_l2"],
        "ok": exact["ok"] and (cosine is None or cosine > COSINE), "gaussians": seen, "stages": parts, "goal": goal,
    }  # fmt: skip


def visible(trainer: Trainer) -> float:
    """Gaussians that a view shows, mean over the views.

    Args:
        trainer: Whose model is looked at.
    """
    counts = [
        int((_drawn(trainer, index)[1] > 0).sum()) for index in range(len(trainer.plan.views))
    ]
    return sum(counts) / len(counts)


@torch.no_grad()
def _drawn(trainer: Trainer, index: int) -> tuple[Float[Tensor, "h w 3"], Float[Tensor, " n"]]:
    """Image and radii of one of the plan's views."""
    view, model = trainer.plan.views[index].without_truth(), trainer.model
    splats = model.splats(view, TRAINED)
    output = trainer.backend.draw(
        view.camera, splats, background=trainer.background, mode=model.mode
    )
    return model.finish_image(view, output), output.radii


def errors(trainer: Trainer) -> dict[str, float]:
    """How far the kernels of networks are from torch: image of a view, gradient of a step.

    Args:
        trainer: In the middle of its training; it takes no step.
    """
    state = trainer.generator.get_state()

    def looked() -> tuple[Tensor, dict[str, Tensor]]:
        trainer.generator.set_state(state)  # both draw the same
        image, _ = _drawn(trainer, 0)
        trainer.backward(trainer.plan.views[0])
        gradients = {}
        for name, value in trainer.model.parameters.trained.items():
            gradients[name] = torch.zeros_like(value) if value.grad is None else value.grad
            value.grad = None
        return image, gradients

    with by_torch():
        true_image, truth = looked()
    image, gradients = looked()
    floor = FLOOR * max(float(value.norm()) for value in truth.values())
    each = [compare_gradients(gradients[name], truth[name], floor=floor) for name in truth]
    return {
        "max_abs_error": largest_error(image, true_image),
        "grad_rel_l2": max(one.relative_l2 for one in each),
        "grad_cosine": min(one.cosine for one in each),
    }
