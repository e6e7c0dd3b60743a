"""The 3D smoothing filter: no Gaussian is finer than what the training photos can tell apart."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.types.camera import Camera, project_points

BORDER = 0.15
"""A camera counts for what lies within its image, grown by this share of its size on every side."""
NEAREST = 0.2
"""A camera counts for what is farther away than this, in scene units, as in the release, and than its near plane."""
TOUCHING = 0.1
"""A share of how far things usually are from their nearest camera; where it is less than NEAREST, cameras count for
what is farther away than that: of a flight in kilometres all that it shows may lie about 0.2 units away."""


def sampling_widths(cameras: Sequence[Camera], means: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Width of a pixel where each Gaussian is: smallest depth in a training camera, by focal length.

    The focal length is the largest of all cameras. What no camera sees gets the largest width of
    what is seen; 0 where nothing is.

    Args:
        cameras: Training cameras.
        means: World positions in scene units.

    Returns: Scene units a pixel.

    Source: Yu et al. 2024, "Mip-Splatting", Eq. 6 and its release, which draws nothing nearer than 0.2 units; large
        units of length: ours.
    """
    nearest = _nearest(cameras, means, 0.0)
    known = nearest[nearest.isfinite()]
    if len(known):
        usual = float(known.kthvalue(len(known) // 2 + 1).values)
        beyond = min(NEAREST, TOUCHING * usual)
        if bool((known <= beyond).any()):
            nearest = _nearest(cameras, means, beyond)
    seen = nearest.isfinite()
    most = nearest[seen].max() if seen.any() else nearest.new_zeros(())
    focal = max(float(camera.K[0, 0]) for camera in cameras)
    return torch.where(seen, nearest, most) / focal


def _nearest(
    cameras: Sequence[Camera], means: Float[Tensor, "n 3"], beyond: float
) -> Float[Tensor, " n"]:
    """Smallest depth above `beyond` and the near plane in a camera that sees a Gaussian; inf where none does."""
    nearest = means.new_full((len(means),), torch.inf)
    for camera in cameras:
        pixels, depths = project_points(camera, means)
        size = pixels.new_tensor([camera.width, camera.height])
        inside = ((pixels >= -BORDER * size) & (pixels <= (1 + BORDER) * size)).all(dim=1)
        counts = inside & (depths > max(beyond, camera.near))
        nearest = torch.where(counts, torch.minimum(nearest, depths), nearest)
    return nearest


def smoothed(
    scales: Float[Tensor, "n 3"], opacities: Float[Tensor, " n"], filters: Float[Tensor, " n"]
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Scales sqrt(s^2 + f^2), and opacities times the product of s / sqrt(s^2 + f^2).

    The ratio is taken axis by axis: a product of three squared scales would underflow.

    Args:
        scales: Standard deviations in scene units, > 0.
        opacities: In [0, 1].
        filters: Standard deviation f of the filter of each Gaussian, in scene units.

    Source: Yu et al. 2024, "Mip-Splatting", Eq. 7.
    """
    wide = (scales.square() + filters.square()[:, None]).sqrt()
    return wide, opacities * (scales / wide).prod(dim=1)
