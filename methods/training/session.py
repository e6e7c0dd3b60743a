"""One whole fit around the trainer: threads, stages timed, a killed run continued."""

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, TypeVar

from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.run import Run
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.threads import threads
from splatproof.reference.types.scene import Scene

M = TypeVar("M", bound=Model)


def run_key(scene: Scene, settings: Any, run: Run, *special: str) -> str:
    """Everything that a trained model depends on beside code and machine, as text.

    Args:
        scene: The scene; its training cameras and points count, photos by name.
        settings: Frozen dataclass of the method.
        run: The run; its seed, background, backend and device count.
        special: What else the model depends on, as text.
    """
    return json.dumps(
        [scene.name, scene_digest(scene), asdict(settings), run.seed, run.background, run.backend,
         run.device, *special]
    )  # fmt: skip


def train(run: Run, prepare: Callable[[], tuple[M, Plan]]) -> M:
    """Train a model to the end of its plan, or continue it, and return it.

    Stages "init" (prepare and resume) and "train" are timed, work is counted, and the record says
    whether the kernels' own step or autograd computed the gradients.

    Args:
        run: Where checkpoints go, and who is told.
        prepare: Makes the model and the plan; called with the run's threads.

    Raises: UsageError if a checkpoint belongs to another run; SplatproofError if the loss stops
        being finite.
    """
    with threads(run.threads):
        started = time.perf_counter()
        model, plan = prepare()
        trainer = Trainer(model, plan, run)
        trainer.resume()
        run.on_stage("init", time.perf_counter() - started)
        run.on_fact("gradients by", trainer.path)
        trainer.train()
        run.on_stage("train", trainer.seconds)
        for name, count in trainer.counts.named().items():
            if name != "pairs" or trainer.backend.counts_pairs:
                run.on_count(name, count)
        if plan.order is None:  # epochs: no view is visited twice more than another
            drawn = trainer.step * plan.views_per_step
            run.on_count("least_visits", drawn // len(plan.views))
    return model


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
