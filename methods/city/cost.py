"""What a city takes before it is built: a coarse model if any, K blocks, a refinement."""

from splatproof.methods.city.memory_plan import GROWTH
from splatproof.methods.city.settings import CitySettings
from splatproof.methods.contracts.method import Cost
from splatproof.methods.threedgs import cost as threedgs
from splatproof.methods.threedgs.cost import COPIES
from splatproof.reference.types.scene import Scene

START_SECONDS = 3.0
"""CPU seconds of the imports of a block's process."""


def city_cost(settings: CitySettings, scene: Scene) -> Cost:
    """Time of all blocks, which share the Gaussians, and memory of the fullest process.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image is read.
    """
    points = threedgs.starting_points(settings, scene)
    cameras = [view.camera for view in scene.train_views]
    most = settings.density.most
    mean = threedgs.mean_gaussians(settings.iterations, points, most)
    blocks, views = settings.blocks, len(scene.train)
    inner = threedgs.step_seconds(settings, cameras, mean / blocks)
    whole = threedgs.step_seconds(settings, cameras, mean)
    coarse = settings.coarse_iterations * whole
    apart = settings.gcr and settings.refine.parts
    refined = 0.0
    if apart:  # each part visits its own views, at the least
        refined = blocks * inner * settings.refine.steps(settings, views, -(-views // blocks))
    elif settings.gcr:
        refined = whole * settings.refine.steps(settings, views)
    start = START_SECONDS * blocks * (1 + apart) if blocks > 1 else 0.0
    fullest = GROWTH * points / blocks
    if coarse or (settings.gcr and not apart):
        fullest = 2 * mean
    elif apart:  # who puts the parts together holds all, without gradients and moments
        fullest = max(fullest, 2 * mean / COPIES)
    return Cost(
        cpu_seconds=coarse + blocks * inner * settings.iterations + refined + start,
        memory_mb=threedgs.training_memory_mb(
            fullest, image_bytes=threedgs.image_bytes(cameras), pixels=threedgs.largest(scene),
            sh_degree=settings.sh_degree,
        ),
    )  # fmt: skip
