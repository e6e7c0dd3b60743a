"""What training explicit Gaussians takes, before anything has started: time and memory."""

import statistics
from collections.abc import Sequence

from splatproof.base.memory import MEBIBYTE
from splatproof.methods.contracts.method import Cost
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene

PIXEL_STEP = 0.1e-6
"""CPU seconds a pixel of a training step: loss and what compositing costs beside the Gaussians. This
and GAUSSIAN_STEP fit 1000 and 2000 iterations of 3dgs at 240 px on two scenes, native kernels,
AVX-512 at 2.6 GHz, to 25 %. Earlier records correct them for other methods and machines."""
GAUSSIAN_STEP = 0.42e-6
"""CPU seconds a Gaussian of a training step: projection, compositing, gradients and Adam."""
GROWTH_STEPS, GROWTH_MOST = 300, 15.0
"""The mean number of Gaussians grows by the number of sparse points every so many steps, up to this
multiple of it (3.4 to 4.2 measured at 1000 steps, 8.5 to 13 at 2000). At the end it is twice that."""
PROCESS_MB = 450.0
"""Resident size of a process that has imported torch and the kernels."""
COPIES = 8
"""Copies of a Gaussian's numbers while it trains: value, gradient, two moments, and as many again in
densification and the rasterizer."""
IMAGE_BYTES = 12
"""Bytes of a pixel of a training image."""
PIXEL_BYTES = 400
"""Bytes of the render, its gradients and the loss, for each pixel of a view."""


def cost(settings: Settings, scene: Scene) -> Cost:
    """What method 3dgs takes on a scene.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image is read.
    """
    points = starting_points(settings, scene)
    cameras = [view.camera for view in scene.train_views]
    mean = mean_gaussians(settings.iterations, points, settings.density.most)
    return Cost(
        cpu_seconds=step_seconds(settings, cameras, mean) * settings.iterations,
        memory_mb=training_memory_mb(
            2 * mean, image_bytes=image_bytes(cameras), pixels=largest(scene),
            sh_degree=settings.sh_degree,
        ),
    )  # fmt: skip


def starting_points(settings: Settings, scene: Scene) -> int:
    """Number of points that training starts from.

    Args:
        settings: Settings of which random_points counts where the scene has no points; how many are
            matched is not known yet.
        scene: The scene, with its sparse points.
    """
    return len(scene.points) or settings.random_points


def mean_gaussians(iterations: int, points: int, most: int | None = None) -> float:
    """Mean number of Gaussians over a run.

    Args:
        iterations: Steps of the run.
        points: Number it starts from.
        most: Cap on the number; None: no cap.
    """
    mean = points * min(1 + iterations / GROWTH_STEPS, GROWTH_MOST)
    return mean if most is None else min(mean, float(max(most, points)))


def step_seconds(settings: Settings, cameras: Sequence[Camera], gaussians: float) -> float:
    """CPU seconds of one step.

    Args:
        settings: Settings of which views_per_step counts.
        cameras: Training cameras, at least one.
        gaussians: Number of Gaussians.
    """
    pixels = statistics.fmean(camera.width * camera.height for camera in cameras)
    return settings.views_per_step * (pixels * PIXEL_STEP + gaussians * GAUSSIAN_STEP)


def image_bytes(cameras: Sequence[Camera], most: int = Run.image_bytes) -> float:
    """Bytes of the training images that are kept in memory.

    Args:
        cameras: Training cameras.
        most: Bound on these bytes.
    """
    return float(min(IMAGE_BYTES * sum(c.width * c.height for c in cameras), most))


def largest(scene: Scene) -> float:
    """Pixels of the largest view."""
    return float(max((v.camera.width * v.camera.height for v in scene.views), default=0))


def training_memory_mb(
    gaussians: float, *, image_bytes: float, pixels: float, sh_degree: int = 3
) -> float:
    """Estimated peak memory of a training process: itself, images, Gaussians, pixels; 2^20 bytes.

    Args:
        gaussians: Number at the end, ghosts included.
        image_bytes: Bytes of the training images that are kept.
        pixels: Pixels of the largest view.
        sh_degree: Degree of the spherical harmonics, 0 to 3.
    """
    numbers = 11 + 3 * (sh_degree + 1) ** 2
    trained = gaussians * 4 * numbers * COPIES
    return PROCESS_MB + (image_bytes + trained + PIXEL_BYTES * pixels) / MEBIBYTE
