"""What this machine could do, and what an image cannot do without: the floors of the engine's stages."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.rasterizer import projection, rotation
from splatproof.reference.types.camera import Camera

GAUSSIANS_AT_ONCE = 100_000
"""Gaussians projected together; memory only."""


@dataclass(frozen=True, kw_only=True)
class Peak:
    """What all threads together do a second at the SIMD level in use."""

    flops: float
    """Floating-point operations; a fused multiply-add counts two."""
    blend_pairs: float
    """Pairs of Gaussian and pixel, forward, everything in the first-level cache."""
    blend_backward_pairs: float
    """The same, backward."""
    bytes: float
    """Read and written by x = x a + y over arrays of a given size."""


def measure_peak(seconds: float, size: int = 2**28) -> Peak:
    """Throughput of idealised loops on torch's number of threads.

    Args:
        seconds: About how long each of the four is measured, in (0, 60].
        size: Bytes that the two arrays of the last one take together; small ones stay in a cache.

    Source: ours.
    """
    use_threads()
    return Peak(**_ext.roofline(seconds, size))


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Work that an image cannot do without."""

    contributing: int
    """Pairs of Gaussian and pixel with alpha >= 1/255 that are drawn before the pixel is full."""
    lanes: int
    """Sixteen for each 4x4 block that a Gaussian's support meets before the block is full."""


def count_pairs(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
) -> Pairs:
    """Count, in double precision, what mode "classic" draws.

    Args:
        camera: The pinhole camera; Gaussians at z <= camera.near are not drawn.
        means: World positions in scene units.
        quaternions: Rotations (w, x, y, z), normalised here; zero is the identity.
        scales: Standard deviations in scene units, >= 0.
        opacities: Opacity of each Gaussian, in [0, 1].

    Source: ours.
    """
    parts = list(_splats(camera, means, quaternions, scales, opacities))
    rows = torch.cat([part[0] for part in parts])
    depths = torch.cat([part[1] for part in parts])
    order = torch.sort(depths, stable=True).indices
    found = _ext.count_pairs(rows[order].contiguous(), camera.width, camera.height)
    return Pairs(contributing=int(found["contributing"]), lanes=int(found["lanes"]))


def _splats(
    camera: Camera, *model: Tensor
) -> Iterator[tuple[Float64[Tensor, "m 8"], Float64[Tensor, " m"]]]:
    """Rows x, y, a, b, c, opacity, half-extents, and depths of what lies before the camera."""
    for part in zip(*(t.detach().split(GAUSSIANS_AT_ONCE) for t in model), strict=True):
        means, quaternions, scales, opacities = (t.double() for t in part)
        flat = projection.project(camera, means, rotation.half_covariance(quaternions, scales))
        inverse = flat.conics
        limit = 2 * (255 * opacities).log().clamp(min=0)
        reach = (limit[:, None] * flat.covariances.diagonal(dim1=1, dim2=2)).sqrt()
        conic = inverse.flatten(start_dim=1)[:, [0, 1, 3]]
        rows = torch.cat([flat.means, conic, opacities[:, None], reach], dim=1)
        yield rows[flat.in_front], flat.depths[flat.in_front]
