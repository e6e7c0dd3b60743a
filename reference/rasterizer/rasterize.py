"""The image that a set of Gaussians defines: dense, any float dtype, differentiable, no tricks.

Every pixel looks at every Gaussian. All backends are held against this module.
"""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.rasterizer import compositing, projection, rotation, spherical_harmonics
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe, pixel_offsets
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput

Mode = Literal["classic", "antialiased"]
PAIRS_AT_ONCE = 2**22
"""Bound on pixels x Gaussians held at a time; memory only, the image does not depend on it."""


def rasterize(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    *,
    colours: Float[Tensor, "u c"] | None = None,
    sh: Float[Tensor, "m k 3"] | None = None,
    background: Float[Tensor, " c"] | None = None,
    mode: Mode = "classic",
    distance: bool = False,
    median: bool = False,
    contributors: int = 0,
    probe: ScreenProbe | None = None,
) -> RenderOutput:
    """Render Gaussians: C = sum_i c_i a_i prod_{j<i} (1 - a_j) + T bg, sorted by camera-space z.

    Args:
        camera: The pinhole camera; Gaussians at z <= camera.near are not drawn.
        means: World positions in scene units.
        quaternions: (w, x, y, z), normalised here; zero is the identity.
        scales: Standard deviations in scene units, >= 0.
        opacities: Opacity of each Gaussian, in [0, 1].
        colours: Colour of each Gaussian, any number of channels; give this or `sh`, or both:
            harmonics of the first Gaussians, and colours of 3 channels of all others.
        sh: Spherical-harmonic coefficients, k in {1, 4, 9, 16}, evaluated along mean - centre.
        background: Colour behind everything; None is black.
        mode: "antialiased" scales opacity by sqrt(det(Sigma2 - 0.3 I) / det(Sigma2)).
        distance: Also return the expected distance to the camera centre.
        median: Also return the median depth.
        contributors: How many of the strongest Gaussians of each pixel to return.
        probe: Where to leave the gradients by the 2D means, for density control.

    Returns: The image; all of it in the dtype of `means`.

    Raises: ValueError if neither `colours` nor `sh` is given, or both for another number of Gaussians.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 4 to 6.
    """
    colours = spherical_harmonics.seen_colours(means, camera.centre, sh, colours)
    flat = projection.project(camera, means, rotation.half_covariance(quaternions, scales))
    if mode == "antialiased":
        opacities = opacities * flat.compensation
    drawn = torch.where(flat.in_front)[0]
    order = drawn[torch.sort(flat.depths[drawn], stable=True).indices]  # ties by index
    far = (means - camera.centre.to(means)).norm(dim=1)
    carried = torch.cat([colours, flat.depths[:, None], far[:, None]], dim=1)[order]

    rows, columns = torch.meshgrid(
        torch.arange(camera.height), torch.arange(camera.width), indexing="ij"
    )
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2).to(means) + 0.5
    blended, left, medians, ids, tops = [], [], [], [], []
    for part in pixels.split(max(1, PAIRS_AT_ONCE // max(1, len(order)))):
        offsets = pixel_offsets(part, flat.means, probe)[:, order]
        alpha = compositing.alphas(offsets, flat.conics[order], opacities[order])
        weight, rest = compositing.weights(alpha)
        blended.append(weight @ carried)
        left.append(rest)
        medians.append(_median(weight, flat.depths[order]))
        best, index = torch.sort(weight.detach(), dim=1, descending=True, stable=True)
        tops.append(_first(best, contributors, 0))
        ids.append(_first(torch.where(best > 0, order[index], -1), contributors, -1))

    shape = (camera.height, camera.width)
    sums, rest = torch.cat(blended), torch.cat(left)
    alpha = 1 - rest
    mean = sums[:, -2:] / alpha.clamp(min=compositing.ALPHA_MIN / 2)[:, None]
    behind = colours.new_zeros(colours.shape[1]) if background is None else background
    return RenderOutput(
        colour=(sums[:, :-2] + rest[:, None] * behind).reshape(*shape, -1),
        alpha=alpha.reshape(shape),
        depth=mean[:, 0].reshape(shape),
        radii=projection.screen_radii(camera, flat, opacities).detach(),
        distance=mean[:, 1].reshape(shape) if distance else None,
        median_depth=torch.cat(medians).reshape(shape) if median else None,
        contributor_ids=torch.cat(ids).reshape(*shape, -1) if contributors else None,
        contributor_weights=torch.cat(tops).reshape(*shape, -1) if contributors else None,
    )


def _median(weight: Float[Tensor, "p n"], depths: Float[Tensor, " n"]) -> Float[Tensor, " p"]:
    """Depth of the first contribution that leaves at most half of the light; 0 where none does."""
    crossed = weight.detach().cumsum(dim=1) >= 0.5
    first = (crossed.cumsum(dim=1) == 1) & crossed
    return torch.where(first, depths, 0).sum(dim=1)


def _first(values: Tensor, count: int, fill: int) -> Tensor:
    """The first `count` columns, padded with `fill` where there are fewer."""
    missing = max(0, count - values.shape[1])
    return torch.nn.functional.pad(values[:, :count], (0, missing), value=fill)
