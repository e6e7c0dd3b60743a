"""What training stratosplat takes, before anything has started: time and memory."""

import statistics

from splatproof.base.memory import MEBIBYTE
from splatproof.methods.contracts.method import Cost
from splatproof.methods.stratosplat.settings import StratoSplat
from splatproof.methods.stratosplat.virtual import hits_of
from splatproof.methods.threedgs import cost as threedgs
from splatproof.reference.types.scene import Scene

VIRTUAL_STEP = 2.5e-6
"""CPU seconds a virtual Gaussian of a training step: the field and its gradients, rasterizing."""
EXPLICIT_STEP = 0.8e-6
"""CPU seconds an explicit Gaussian of a step beside what 3dgs says: gradients go through a graph."""
COMPLETED_PIXEL = 8e-6
"""CPU seconds a pixel of a photo whose depth is completed."""
VIRTUAL_BYTES = 1200
"""Bytes of the graph of a virtual Gaussian."""
KEPT = 0.4
"""Layers of the memory a completed pixel: photos overlap."""


def cost(settings: StratoSplat, scene: Scene) -> Cost:
    """What method stratosplat takes on a scene.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image is read.
    """
    cameras = [view.camera for view in scene.train_views]
    plain = threedgs.cost(settings, scene)
    pixels = 0.0
    for camera in cameras:
        share = min(1.0, settings.completion.side / max(camera.width, camera.height))
        pixels += share**2 * camera.width * camera.height
    virtual = statistics.fmean(hits_of(settings.planes, camera) for camera in cameras)
    seconds, memory = plain.cpu_seconds, plain.memory_mb
    if settings.completes:
        started = KEPT * pixels
        seconds += COMPLETED_PIXEL * pixels
        seconds += started * threedgs.GAUSSIAN_STEP * settings.iterations
        memory += 2 * started * threedgs.COPIES * 4 * 59 / MEBIBYTE
    if virtual:
        steps = settings.iterations * settings.views_per_step
        points = KEPT * pixels if settings.completes else len(scene.points)
        seconds += steps * (VIRTUAL_STEP * virtual + EXPLICIT_STEP * points)
        memory += virtual * VIRTUAL_BYTES / MEBIBYTE
    return Cost(cpu_seconds=seconds, memory_mb=memory)
