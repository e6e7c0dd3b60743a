"""What training hdgs takes, before anything has started: time and memory."""

import statistics

from splatproof.base.memory import MEBIBYTE
from splatproof.methods.contracts.method import Cost
from splatproof.methods.hdgs.settings import Settings
from splatproof.methods.threedgs.cost import PIXEL_BYTES, PROCESS_MB, image_bytes, largest
from splatproof.reference.types.scene import Scene

PIXEL_STEP = 0.5e-6
"""CPU seconds a pixel of a training step: sky, LiDAR and depth terms beside the photo's."""
SLOT_STEP = 1.1e-6
"""CPU seconds a Gaussian of an anchor, shown or not, of a training step. Measured on street small, 500
steps, with other work on the machine: 103 ms a step of 38,400 pixels and 6,000 anchors of 12."""
GROWN = 1.4
"""Mean number of anchors in units of the starting number: 1.3 in 500 steps on street small."""
SLOT_BYTES = 400
"""Bytes of the graph of a decoded Gaussian."""


def cost(settings: Settings, scene: Scene) -> Cost:
    """What method hdgs takes on a scene.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image is read.
    """
    cameras = [view.camera for view in scene.train_views]
    swept = settings.from_sweeps and any(view.load_sweep for view in scene.train_views)
    started = settings.anchors if swept else min(settings.anchors, len(scene.points))
    slots = settings.sizes.gaussians * started * GROWN
    pixels = statistics.fmean(camera.width * camera.height for camera in cameras)
    step = settings.views_per_step * (pixels * PIXEL_STEP + slots * SLOT_STEP)
    numbers = image_bytes(cameras) + 2 * slots * SLOT_BYTES + PIXEL_BYTES * largest(scene)
    return Cost(cpu_seconds=step * settings.iterations, memory_mb=PROCESS_MB + numbers / MEBIBYTE)
