"""What training scaffold-gs takes, before anything has started: time and memory."""

import statistics

from splatproof.base.memory import MEBIBYTE
from splatproof.methods.anchors.sight import share_in_view
from splatproof.methods.contracts.method import Cost
from splatproof.methods.scaffold.settings import Settings
from splatproof.methods.threedgs.cost import PIXEL_BYTES, PROCESS_MB, image_bytes, largest
from splatproof.reference.types.scene import Scene

PIXEL_STEP = 0.1e-6
"""CPU seconds a pixel of a training step, as for 3dgs."""
SLOT_STEP = 0.7e-6
"""CPU seconds a Gaussian of an anchor in view, shown or not, of a training step: decoding and its
gradients, rasterizing those that show, Adam. Measured on courtyard at 240 px, 1500 steps, where views
show 0.72 of the points: 0.64e-6; on tunnel, 0.17 of them: 0.75e-6."""
GROWTH_STEPS, GROWTH_MOST = 650, 6.0
"""The mean number of anchors grows by the starting number every so many steps (3.3 times it measured at
1500 steps on courtyard), up to this multiple."""
SLOT_BYTES = 400
"""Bytes of the graph of a decoded Gaussian."""


def cost(settings: Settings, scene: Scene) -> Cost:
    """What method scaffold-gs takes on a scene.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image is read.
    """
    points = len(scene.points) or settings.random_points
    cameras = [view.camera for view in scene.train_views]
    slots = settings.k * points * min(1 + settings.iterations / GROWTH_STEPS, GROWTH_MOST)
    pixels = statistics.fmean(camera.width * camera.height for camera in cameras)
    seen = slots * share_in_view(scene)
    step = settings.views_per_step * (pixels * PIXEL_STEP + seen * SLOT_STEP)
    numbers = image_bytes(cameras) + 2 * slots * SLOT_BYTES + PIXEL_BYTES * largest(scene)
    return Cost(cpu_seconds=step * settings.iterations, memory_mb=PROCESS_MB + numbers / MEBIBYTE)
