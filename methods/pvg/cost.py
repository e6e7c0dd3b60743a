"""What training pvg takes, before anything has started: time and memory."""

import statistics

from splatproof.methods.contracts.method import Cost
from splatproof.methods.pvg.settings import Settings
from splatproof.methods.threedgs.cost import (
    image_bytes,
    largest,
    mean_gaussians,
    training_memory_mb,
)
from splatproof.reference.types.scene import Scene

PIXEL_STEP = 0.2e-6
"""CPU seconds a pixel of a training step: loss, sky, LiDAR, and compositing beside the Gaussians."""
GAUSSIAN_STEP = 1e-6
"""CPU seconds a Gaussian of a training step, gradients through a graph. Measured on street at 240 px:
45 s for 1000 steps, which this says, and about 300 s for 3000, where it says 210 s."""


def cost(settings: Settings, scene: Scene) -> Cost:
    """What method pvg takes on a scene.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image and no sweep is read.
    """
    points = len(scene.points) or settings.random_points
    mean = mean_gaussians(settings.iterations, points, settings.density.most)
    mean += settings.start.sweep_points
    cameras = [view.camera for view in scene.train_views]
    pixels = statistics.fmean(camera.width * camera.height for camera in cameras)
    step = settings.views_per_step * (pixels * PIXEL_STEP + mean * GAUSSIAN_STEP)
    memory = training_memory_mb(
        2 * mean, image_bytes=image_bytes(cameras), pixels=largest(scene),
        sh_degree=settings.sh_degree,
    )  # fmt: skip
    return Cost(cpu_seconds=step * settings.iterations, memory_mb=memory)
