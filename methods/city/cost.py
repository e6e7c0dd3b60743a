"""What a city takes before it is built: a coarse model if any, K blocks, a refinement."""

from splatproof.methods.city.memory_plan import GROWTH
from splatproof.methods.city.settings import CitySettings
from splatproof.methods.contracts.method import Cost
from splatproof.methods.threedgs import cost as threedgs
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
    blocks = settings.blocks
    each = threedgs.step_seconds(settings, cameras, mean / blocks) * settings.iterations
    whole = threedgs.step_seconds(settings, cameras, mean)
    coarse = settings.coarse_iterations * whole
    refined = settings.refine.steps(settings, len(scene.train)) * whole if settings.gcr else 0.0
    start = START_SECONDS * blocks if blocks > 1 else 0.0
    fullest = 2 * mean if settings.gcr or coarse else GROWTH * points / blocks
    return Cost(
        cpu_seconds=coarse + blocks * each + refined + start,
        memory_mb=threedgs.training_memory_mb(
            fullest, image_bytes=threedgs.image_bytes(cameras), pixels=threedgs.largest(scene),
            sh_degree=settings.sh_degree,
        ),
    )  # fmt: skip
