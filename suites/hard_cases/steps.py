"""Hard cases of whole methods: one training step from a nasty start, as users get it and in float64."""

import math
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatproof.base.typed_toml import build
from splatproof.methods.auto.facts import facts_of
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.usual import usual
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.point_roles import CONTEXT, GHOST, OWN
from splatproof.methods.city.train_block import BlockJob
from splatproof.methods.city.train_block import prepare as prepare_block
from splatproof.methods.contracts.model import Model, Moment
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.dlg_gs import fit as dlg_gs
from splatproof.methods.dpgs.refiners import refiner_of
from splatproof.methods.dpgs.side_training import with_side_views
from splatproof.methods.dpgs.spirals import side_cameras
from splatproof.methods.hdgs import fit as hdgs
from splatproof.methods.pvg import fit as pvg
from splatproof.methods.registry import get_method
from splatproof.methods.scaffold import fit as scaffold
from splatproof.methods.sparse_views import cor_gs, fsgs
from splatproof.methods.stratosplat import fit as stratosplat
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs import mip_splatting
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.plan import Plan
from splatproof.reference.checks.agreement import compare_gradients
from splatproof.reference.checks.discontinuities import discontinuity_pixels
from splatproof.reference.types.scene import Scene
from splatproof.suites.hard_cases.nasty_scene import nasty_scene

Prepare = Callable[[Scene, Any, Run], tuple[Model, Plan]]
STEPS, STEP = 60, 50
"""Steps of the run, and the one that is judged: bands, dropout and late terms are on."""
VIEW = 1
"""Which of the plan's views is judged."""
NEEDLE, OPAQUE = 1e3, 14.0
"""How much longer one axis of every other row is than the others, and the opacity logit of every third."""
COMPONENT, LADDER = "training step", "distance from the origin"


def dpgs(scene: Scene, settings: Any, run: Run) -> tuple[Model, Plan]:
    """Method 3dgs with side views among its views.

    Args:
        scene: With points.
        settings: Settings of method dpgs.
        run: Backend and seed.
    """
    model, plan = threedgs.prepare(scene, settings, run)
    cameras = side_cameras(scene, settings.side)
    return model, with_side_views(
        cameras, scene, model, plan, settings.side, refiner_of(settings.side), run
    )


def block(scene: Scene, settings: Any, run: Run) -> tuple[Model, Plan]:
    """A block of a city that holds the scene: its own points, some of its context and some ghosts.

    Args:
        scene: With points.
        settings: Settings of a method that trains in blocks.
        run: Backend and seed.
    """
    roles = torch.tensor([OWN, OWN, CONTEXT, GHOST], dtype=torch.int8)
    count = len(scene.points)
    job = BlockJob(
        scene=scene, roles=roles.repeat(count)[:count], settings=settings, folder=Path("nowhere"),
        facts=BlockFacts(block=0, views=len(scene.train), points=count, load=count),
        centre=scene.points.positions.mean(dim=0), frame=torch.eye(3, dtype=torch.float64),
        follow=settings.follow, seed=run.seed, backend=run.backend,
        sampling=settings.bins if settings.sampling == "balanced" else None,
    )  # fmt: skip
    return prepare_block(job, None, run)


def planned(scene: Scene, settings: AutoSettings, run: Run) -> tuple[Model, Plan]:
    """Method auto without its probe: what facts alone decide, trained as 3dgs.

    Args:
        scene: With points.
        settings: The budget.
        run: Backend and seed.
    """
    chosen = usual(settings, facts_of(scene))
    return threedgs.prepare(threedgs.started(scene, chosen, run), chosen, run)


PREPARED: dict[str, Prepare] = {
    "3dgs": threedgs.prepare, "auto": planned, "absgs": threedgs.prepare, "dropgaussian": threedgs.prepare,
    "mip-splatting": mip_splatting.prepare, "fsgs": fsgs.prepare, "cor-gs": cor_gs.prepare, "dpgs": dpgs,
    "scaffold-gs": scaffold.prepare, "hdgs": hdgs.prepare, "pvg": pvg.prepare, "dlg-gs": dlg_gs.prepare,
    "stratosplat": stratosplat.prepare, "citygaussian": block, "vastgaussian": block,
    "blockgaussian": block, "dpgs-partition": block, "stitchgs": block, "odbp+stitch": block,
}  # fmt: skip
"""How each method makes its model and its plan. All of a city's methods train a block."""
ANCHORED = {"k": 4, "features": 8}
DRIVING = {"sky": {"resolution": 8}}
WHOLE = {"reset_interval": 0, "largest_size": 10.0}
"""Density control that leaves some of so few Gaussians: in so short a run a reset is followed by a pruning before
opacities are back (dropgaussian keeps 1 of 38, and its loss is three times that of its start)."""
SMALL: dict[str, dict[str, Any]] = {
    "dropgaussian": {"density": WHOLE}, "cor-gs": {"density": {"reset_interval": 0}, "prune_interval": 60_000},
    "dpgs": {"side": {"every": 3, "refresh": 7500, "spiral": {"layers": 1, "views": 2}}},
    "scaffold-gs": ANCHORED, "dlg-gs": ANCHORED | {"head": 8},
    "hdgs": DRIVING | {"gaussians": 6, "features": 8, "instance": 4, "anchors": 40, "depth": {"crop": 9}},
    "pvg": DRIVING, "stratosplat": {"init": "sfm", "planes": {"count": 3, "stride": 3, "finest": 16},
                                    "completion": {"guidance_steps": 3}},
    "citygaussian": {"coarse_iterations": 5},
}  # fmt: skip
"""Settings that make a method's networks and grids as small as the scene."""


def settings_of(method: str, steps: int = STEPS) -> Any:
    """A method's settings for a scene of a few tiny photos.

    Args:
        method: Name of the method.
        steps: Training steps of the run.
    """
    kind = get_method(method).settings
    length = "iterations" if hasattr(kind, "iterations") else "steps"
    return build(kind, {length: steps} | SMALL.get(method, {}), "hard case")


def started(method: str, distance: float, run: Run) -> tuple[Model, Plan]:
    """A method's model on the nasty scene, with needles and opaque rows where rows have scales and opacities.

    Args:
        method: Name of the method.
        distance: How far from the origin the scene lies, scene units.
        run: Backend and seed.
    """
    scene = nasty_scene(distance).for_training()
    model, plan = PREPARED[method](scene, settings_of(method), run)
    rows = model.parameters.rows
    rows["log_scales"][::2, 1:3] -= math.log(NEEDLE)
    if "opacity_logits" in rows:
        rows["opacity_logits"][::3] = OPAQUE
    return model, plan


def widened(parameters: Parameters) -> None:
    """Turn all floating tensors to float64, in place."""
    for group in (parameters.rows, parameters.shared, parameters.labels):
        for name, value in group.items():
            group[name] = value.double() if value.is_floating_point() else value


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """What one step found."""

    loss: float
    gradients: dict[str, Tensor]
    path: str
    """What computed the gradients: "kernels" or "autograd"."""


def step_of(method: str, distance: float, run: Run, *, wide: bool, counted: Tensor | None) -> Step:
    """Loss and gradients of one view of one step.

    Args:
        method: Name of the method.
        distance: How far from the origin the scene lies, scene units.
        run: Backend and seed.
        wide: In float64, by the reference and autograd alone.
        counted: Pixels that count; None: all.
    """
    trainer = at_step(method, distance, run, wide=wide)
    view = trainer.plan.views[VIEW]
    if wide:
        load = view.load
        view = replace(view, load=lambda: load().double())
    if counted is not None:
        view = replace(view, load_mask=counted.clone)
    values, _ = trainer.backward(view)
    gradients = {
        name: torch.zeros_like(value) if value.grad is None else value.grad.detach()
        for name, value in trainer.model.parameters.trained.items()
        if name in trainer.model.schedules
    }
    return Step(loss=values["loss"], gradients=gradients, path=trainer.path)


def at_step(method: str, distance: float, run: Run, *, wide: bool) -> Trainer:
    """The trainer of a method before the step that is judged.

    Args:
        method: Name of the method.
        distance: How far from the origin the scene lies, scene units.
        run: Backend and seed.
        wide: With a model in float64.
    """
    model, plan = started(method, distance, run)
    if wide:
        widened(model.parameters)
    trainer = Trainer(model, plan, run)
    trainer.step = STEP
    return trainer


def discontinuities(method: str, distance: float, run: Run) -> Tensor:
    """Pixels of the judged view on which rounding may decide.

    Args:
        method: Name of the method.
        distance: How far from the origin the scene lies, scene units.
        run: Seed.
    """
    trainer = at_step(method, distance, run, wide=True)
    view = trainer.plan.views[VIEW]
    moment = Moment(step=STEP, total=STEPS, generator=trainer.generator)
    with torch.no_grad():
        splats = trainer.model.splats(view.without_truth(), moment)
    return discontinuity_pixels(
        view.camera, splats.means, splats.quaternions, splats.scales, splats.opacities,
        mode=trainer.model.mode,
    )  # fmt: skip


BUDGET, GRADIENT = 2e-5, 1e-3
"""Largest difference of the loss, of the loss where it is above 1, and relative L2 of each gradient, as for twins."""
FARTHEST = 30.0
"""Times GRADIENT that method hdgs may be off far away: it decodes positions into the scene's frame in float32,
so that near ties in depth may change their order. 1e-2 was measured from a distance of 100 on; with positions
rounded in the truth too, 4e-6 at any."""
KINKED = 10.0
"""Times GRADIENT that method dlg-gs may be off: its dropout term is an L1 of two renders that are equal but for rounding
where nothing was dropped, and there rounding has the sign. 4.5e-3 was measured at distances from 1 on, and 2e-6 without
the term."""
RUNGS = (1.0, 1e2, 1e4)
"""Distances from the origin in scene units; cameras stand up to 1 apart."""


def judge(method: str, distance: float, threads: int | None = 1) -> dict[str, Any]:
    """A row as those of ladders: one training step against float64 and autograd.

    Args:
        method: Name of the method.
        distance: How far from the origin the scene lies, scene units.
        threads: Threads of the kernels; None leaves them alone.
    """
    exact = Run(backend="reference", threads=threads)
    ignored = discontinuities(method, distance, exact)
    start = time.perf_counter()
    found = step_of(
        method, distance, Run(backend="cpu", threads=threads), wide=False, counted=~ignored
    )
    ms = 1e3 * (time.perf_counter() - start)
    truth = step_of(method, distance, exact, wide=True, counted=~ignored)
    floor = 1e-6 * max(float(value.norm()) for value in truth.gradients.values())
    each = {
        name: compare_gradients(found.gradients[name], value, floor=floor).relative_l2
        for name, value in truth.gradients.items()
    }
    worst = max(each, key=each.__getitem__)
    error = abs(found.loss - truth.loss) / max(1.0, abs(truth.loss))
    finite = math.isfinite(error) and all(map(math.isfinite, each.values()))
    far = min(FARTHEST, max(1.0, distance / 3)) if method == "hdgs" else 1.0
    bound = GRADIENT * (KINKED if method == "dlg-gs" else far)
    return {
        "component": COMPONENT, "case": f"{method}, {LADDER} {distance:g}",
        "implementation": f"{method}, {found.path}", "ladder": LADDER, "hardness": distance,
        "expect": "finite", "budget": far * BUDGET, "discontinuity_pixels": int(ignored.sum()),
        "finite": finite, "max_abs_error": error, "grad_rel_l2": max(each.values()), "ms": ms,
        "ok": finite and error <= far * BUDGET and each[worst] <= bound,
        "note": f"worst: {worst}",
    }  # fmt: skip


def fitted(method: str, folder: Path) -> dict[str, Any]:
    """A row: a short training of the whole method from the nasty scene; finite, and its loss falls.

    Args:
        method: Name of the method.
        folder: Empty folder for what the run keeps.
    """
    scene, losses = nasty_scene(RUNGS[-1]), []

    def told(step: int, total: int, values: dict[str, float]) -> None:
        del step, total
        losses.append(values["loss"])

    run = Run(folder=folder, threads=1, engine="inline", report=told)
    start = time.perf_counter()
    model = get_method(method).fit(scene.for_training(), settings_of(method, 3 * STEPS), run)
    ms = 1e3 * (time.perf_counter() - start)
    third = len(losses) // 3
    before, after = (sum(part) / max(1, third) for part in (losses[:third], losses[-third:]))
    seen = [model.render(view) for view in scene.views]
    finite = all(bool(part.isfinite().all()) for out in seen for part in (out.colour, out.alpha))
    finite &= all(map(math.isfinite, losses))
    return {
        "component": "training", "case": f"{method}, {LADDER} {RUNGS[-1]:g}", "implementation": method,
        "expect": "finite", "budget": before, "discontinuity_pixels": 0, "finite": finite,
        "max_abs_error": after, "grad_rel_l2": 0.0, "ms": ms, "ok": finite and after < before,
        "note": "loss of the last third of the steps, below that of the first",
    }  # fmt: skip


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """Every method's steps, and unless it is to be quick a short training of each.

    Args:
        quick: Only steps at the farthest place.
    """
    for method in PREPARED:
        for distance in RUNGS[-1:] if quick else RUNGS:
            yield judge(method, distance)
    if not quick:
        for method in PREPARED:
            with tempfile.TemporaryDirectory() as folder:
                yield fitted(method, Path(folder))
