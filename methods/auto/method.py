"""Method auto as the registry knows it."""

import torch

from splatproof.methods.auto.base import completed
from splatproof.methods.auto.completion import FEW
from splatproof.methods.auto.fit import fit
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.contracts.method import Cost, Method
from splatproof.methods.stratosplat import cost as stratosplat
from splatproof.methods.threedgs.cost import image_bytes, largest, training_memory_mb
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.types.scene import Scene

GROWTH = 4.0
"""How many Gaussians a point is taken to become, for memory alone."""


def cost(settings: AutoSettings, scene: Scene) -> Cost:
    """What method auto takes: the seconds that it is given, on all threads.

    Args:
        settings: The budget.
        scene: Opened under the protocol; no image is read.
    """
    memory = training_memory_mb(
        GROWTH * len(scene.points), pixels=largest(scene),
        image_bytes=image_bytes([view.camera for view in scene.train_views]),
    )  # fmt: skip
    if settings.completed or (settings.completed is None and len(scene.train) <= FEW):
        memory = max(memory, stratosplat.cost(completed(Settings(), scene), scene).memory_mb)
    return Cost(cpu_seconds=settings.seconds * torch.get_num_threads(), memory_mb=memory)


AUTO = Method(
    name="auto",
    settings=AutoSettings,
    fit=fit,
    cost=cost,
    description="3dgs, pvg where LiDAR sweeps show motion, or stratosplat where few photos from the air see each place, with "
    "every setting planned for the scene, this "
    "machine and a number of seconds: facts are measured, doubtful settings compete on held-out training views",
)
