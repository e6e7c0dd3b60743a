"""Prior `marigold:FOLDER`: a diffusion model of depth, in the scale of the SfM points, from a local folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.priors.alignment import LEAST_POINTS, aligned
from splatproof.methods.priors.diffusers_folder import pipeline
from splatproof.reference.supervision.dense_initialisation import observations, points_of
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import DepthPrior, Scene

DISPARITY = "disparity"
"""What the configuration of a network says that predicts disparity; others predict depth."""
SILENT = (
    f"fewer than {LEAST_POINTS} sparse points in sight follow it, which give it its scale; take "
    "'depth-anything', which needs none"
)
"""Why nothing is said of a view."""


def prepare(scene: Scene, weights: Path | None, seed: int) -> Callable[[int], DepthPrior]:
    """How to make the prior of a view, by its index in the scene.

    The network predicts depth up to scale and shift, of which no disparity can be made; the scale and shift are
    those of the view's SfM points (least absolute deviations). It is asked once: guidance of a method that completes
    depths does not enter its steps. Of a view with fewer than LEAST_POINTS points, or with points that contradict it,
    it says nothing.

    Args:
        scene: Any scene with sparse points and tracks.
        weights: Folder of a MarigoldDepthPipeline, see `pipeline`.
        seed: Seed of the noise that it starts from.

    Raises: MissingError without the library; DataError where the folder is not such a model's.

    Source: Ke et al. 2024, "Repurposing Diffusion-Based Image Generators for Monocular Depth Estimation", through
        diffusers; the fit: ours.
    """
    assert weights is not None
    network = pipeline(weights, "MarigoldDepthPipeline", "depth prior 'marigold'", "'sweep'")
    seen = observations(scene.points, len(scene.views))

    def make(index: int) -> DepthPrior:
        view = scene.views[index]
        said = _said(network, view.load(), seed)
        if network.config.prediction_type == DISPARITY:
            return DepthPrior(disparity=said, valid=said.isfinite())
        return in_disparity(said, view.camera, scene.points.positions[points_of(seen, index)])

    return make


def _said(network: Any, photo: Float[Tensor, "h w 3"], seed: int) -> Float[Tensor, "h w"]:
    """The prediction of a photo in its size; the noise is drawn by the seed alone."""
    with torch.inference_mode():
        said = network(
            photo.permute(2, 0, 1)[None], generator=torch.Generator().manual_seed(seed), output_type="pt",
        ).prediction  # fmt: skip
    return said.reshape(photo.shape[:2]).float().clone()


def in_disparity(
    depth: Float[Tensor, "h w"], camera: Camera, points: Float[Tensor, "n 3"]
) -> DepthPrior:
    """Disparity of a depth of unknown scale and shift, with those that SfM points say.

    Args:
        depth: Larger where farther.
        camera: The view's camera.
        points: Sparse points that the view sees.
    Returns: Valid where the depth that comes out lies before the camera; nowhere if too few points are seen, or they
        contradict the depth.
    """
    at, z = project_points(camera, points)
    column, row = at.floor().long().T
    inside = (z > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    fit = None
    if int(inside.sum()) >= LEAST_POINTS:
        fit = aligned(depth[row[inside], column[inside]], z[inside])
    if fit is None or fit[0] <= 0:
        nothing = torch.zeros_like(depth)
        return DepthPrior(disparity=nothing, valid=nothing > 0)
    metres = fit[0] * depth + fit[1]
    valid = metres > camera.near
    disparity = torch.where(valid, 1 / metres.clamp(min=camera.near), 0)
    return DepthPrior(disparity=disparity.float(), valid=valid)
