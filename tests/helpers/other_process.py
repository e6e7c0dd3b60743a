"""What a saved model shows in a process that did not make it."""

from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from splatproof.base.processes import Worker
from splatproof.methods.loading import load_reconstruction
from splatproof.reference.types.scene import Scene
from splatproof.suites.workers import PRELOAD


def shown_elsewhere(
    model: Path, scene: Callable[[], Scene], view: int, **changes: Any
) -> dict[str, np.ndarray]:
    """Colour and alpha of a saved model, loaded and rendered by another process.

    Args:
        model: Folder of the model.
        scene: Makes the scene there; importable by name.
        view: Which of its views is rendered.
        changes: What is replaced of the view.
    """
    with Worker(_show, model, scene, view, changes, preload=PRELOAD) as worker:
        return worker.receive()


def _show(
    says: Connection, model: Path, scene: Callable[[], Scene], view: int, changes: dict[str, Any]
) -> None:
    shown = load_reconstruction(model).render(replace(scene().views[view], **changes))
    # arrays are sent whole; tensors would be files that end with this process
    says.send({"colour": shown.colour.numpy(), "alpha": shown.alpha.numpy()})
