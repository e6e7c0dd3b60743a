"""Terms of driving scenes: LiDAR depth, and opacity by the masks of the sky."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.datasets.image_cache import TensorCache
from splatproof.methods.dynamic.settings import LidarSettings, SkySettings
from splatproof.methods.training.schedules import shrink
from splatproof.methods.training.terms import Frame, Term
from splatproof.reference.supervision.depth_supervision import lidar_loss, sky_loss
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import Scene

KEPT_BYTES = 2**28
"""Most bytes of LiDAR images and sky masks, each, that are kept between steps."""


def scene_terms(
    scene: Scene, lidar: LidarSettings, sky: SkySettings, *, steps: int, extent: float
) -> tuple[Term, ...]:
    """The terms that the settings ask for.

    Args:
        scene: What is trained on.
        lidar: The LiDAR term is among them if its weight is above 0.
        sky: The sky term is among them if its weight and resolution are above 0.
        steps: Number of steps of the run.
        extent: Size of the scene in scene units, which depths are counted in.

    Raises: DataError if the scene lacks what a term reads, with the setting that does without.
    """
    terms: list[Term] = []
    if lidar.weight:
        require_sweeps(scene)
        terms.append(lidar_term(lidar, steps=steps, extent=extent))
    if sky.weight and sky.resolution:
        require_sky(scene)
        terms.append(sky_term(sky))
    return tuple(terms)


def lidar_term(settings: LidarSettings, *, steps: int, extent: float) -> Term:
    """L1 of rendered depth against the view's sweep, mean over the pixels it hit.

    Depths are divided by the scene's extent. Inverse depths are those of what is drawn in front of
    nothing: alpha / z, so that too thin a surface is too far away (the release of PVG puts a sky 900
    units away in nothing's place).

    Args:
        settings: What is compared, and with which weight.
        steps: Number of steps of the run; a short one sheds the weight sooner.
        extent: Size of the scene in scene units.
    """
    images = TensorCache(KEPT_BYTES)
    decay = settings.decay * shrink(steps)

    def loss(frame: Frame) -> Float[Tensor, ""]:
        load, output = frame.view.load_sweep, frame.output
        if load is None:
            return output.depth.new_zeros(())
        measured = images.get(
            frame.view, lambda: lidar_image(frame.view.camera, load().positions)
        ).to(output.depth)
        hit = measured > 0
        if frame.mask is not None:
            hit &= frame.mask
        weight = math.exp(-frame.moment.step / decay) if decay else 1.0
        if not settings.inverse:
            return weight * lidar_loss(output.depth, measured, hit) / extent
        near = frame.view.camera.near
        drawn = output.alpha / output.depth.clamp(min=near)
        return weight * extent * lidar_loss(drawn, 1 / measured.clamp(min=near), hit)

    return Term(name="lidar", loss=loss, weight=settings.weight)


def sky_term(settings: SkySettings) -> Term:
    """Cross-entropy that wants alpha 0 where the view's mask shows sky and 1 elsewhere.

    The release of PVG wants 0 in the sky and leaves the rest alone; both sides: HDGS.

    Args:
        settings: Its weight.
    """
    masks = TensorCache(KEPT_BYTES)

    def loss(frame: Frame) -> Float[Tensor, ""]:
        load, alpha = frame.view.load_sky, frame.output.alpha
        if load is None:
            return alpha.new_zeros(())
        sky = masks.get(frame.view, load).to(alpha.device)
        if frame.mask is None:
            return sky_loss(alpha, sky)
        return sky_loss(alpha[frame.mask][None], sky[frame.mask][None])

    return Term(name="sky", loss=loss, weight=settings.weight)


def lidar_image(camera: Camera, positions: Float[Tensor, "n 3"]) -> Float[Tensor, "h w"]:
    """z-depth of the nearest return in each pixel; 0 where there is none.

    Args:
        camera: What the returns are seen from.
        positions: Returns in the scene's frame.

    Source: the release of PVG; of several returns in a pixel it takes any, we the nearest.
    """
    pixels, depth = project_points(camera, positions.double())
    column, row = pixels.floor().unbind(dim=1)
    inside = (depth > camera.near) & (column >= 0) & (column < camera.width)
    inside &= (row >= 0) & (row < camera.height)
    place = (row[inside] * camera.width + column[inside]).long()
    nearest = torch.full((camera.height * camera.width,), torch.inf, dtype=torch.float64)
    nearest.scatter_reduce_(0, place, depth[inside], reduce="amin")
    nearest[nearest.isinf()] = 0
    return nearest.reshape(camera.height, camera.width).float()


def require_sweeps(scene: Scene, without: str = "lidar.weight = 0") -> None:
    """Refuse a scene of whose training views none has a LiDAR sweep.

    Args:
        scene: What is trained on.
        without: Setting that does without, for the error.

    Raises: DataError.
    """
    _require([view.load_sweep for view in scene.train_views], scene, "LiDAR sweep", without)


def require_sky(scene: Scene, without: str = "sky.weight = 0") -> None:
    """Refuse a scene of whose training views none has a mask of the sky.

    Args:
        scene: What is trained on.
        without: Setting that does without, for the error.

    Raises: DataError.
    """
    _require([view.load_sky for view in scene.train_views], scene, "sky mask", without)


def _require(found: Sequence[object], scene: Scene, what: str, without: str) -> None:
    if all(one is None for one in found):
        raise DataError(
            f"scene {scene.name!r}: no training view has a {what}; set {without} to do without"
        )
