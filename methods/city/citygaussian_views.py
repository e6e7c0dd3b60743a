"""How much a view's image changes without a block: CityGaussian's rule for who trains it."""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Bool
from torch import Tensor

from splatproof.datasets.resize import scale_intrinsics
from splatproof.methods.city.ground import Ground
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.training.initialise import from_points
from splatproof.reference.supervision.losses import ssim_map
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians

COARSE_WIDTH = 128
"""Width in pixels of the images by which the rule is decided here."""
COARSE_OPACITY = 0.5
"""Opacity of the Gaussians that stand in for a coarse model, one a sparse point."""


def point_model(place: Ground) -> Gaussians:
    """One Gaussian a sparse point: what is there before any coarse model was trained.

    Args:
        place: The scene, with sparse points and training views.
    """
    return from_points(place.scene, degree=0, opacity=COARSE_OPACITY)


def coarse_change(
    place: Ground, backend: str, model: Gaussians | None = None
) -> Callable[[int, Bool[Tensor, " n"]], float]:
    """1 - SSIM of a view's image of the coarse model, with and without some of its Gaussians.

    0 for views that are not trained on, so that they cost nothing.

    Args:
        place: The scene, and which of its views are trained on.
        backend: Name of the rasterizer.
        model: The coarse model, in the scene's frame; None: one Gaussian a sparse point.

    Returns: change(view, without): the view's index in the scene, and a mask of the Gaussians that
        are left out.

    Source: CityGaussian, Sec. 3.2, Eq. 4.
    """
    rasterize = get_backend(backend).rasterize
    model = model or point_model(place)
    parts = (model.means, model.unit_quaternions, model.scales, model.opacities)

    @torch.no_grad()
    def image(view: int, kept: Bool[Tensor, " n"]) -> Tensor:
        camera = narrowed(place.scene.views[view].camera, COARSE_WIDTH)
        shown = rasterize(camera, *(part[kept] for part in parts), sh=model.sh[kept])
        return shown.colour.clamp(0, 1)

    everything = torch.ones(len(model), dtype=torch.bool)
    whole: dict[int, Tensor] = {}

    def change(view: int, without: Bool[Tensor, " n"]) -> float:
        if not bool(place.trained[view]) or not bool(without.any()):
            return 0.0
        if view not in whole:
            whole[view] = image(view, everything)
        return 1 - float(ssim_map(image(view, ~without), whole[view]).mean())

    return change


def narrowed(camera: Camera, width: int) -> Camera:
    """The camera with an image at most `width` wide.

    Args:
        camera: With an image of any size; one that is narrow enough is returned as it is.
        width: Pixels, at least 1; the height shrinks in proportion.
    """
    if camera.width <= width:
        return camera
    size = (width, max(1, round(camera.height * width / camera.width)))
    K = scale_intrinsics(camera.K, (camera.width, camera.height), size)
    return replace(camera, K=K, width=size[0], height=size[1])
