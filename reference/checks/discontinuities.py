"""Pixels on which two correct rasterizers may differ: those at a discontinuity of the definition."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.rasterizer import compositing, projection, rotation
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.camera import Camera

BAND = 2e-5
"""Relative half-width of a discontinuity: some ten times the float32 error of an alpha or a transmittance."""


def discontinuity_pixels(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    *,
    mode: Mode = "classic",
    band: float = BAND,
) -> Bool[Tensor, "h w"]:
    """Mark pixels where rounding may decide: |alpha - 1/255| or |T - 1e-4| or |T - 1/2| within a band.

    Also pixels that show two Gaussians whose depths differ by less than a float32 can tell. The
    discontinuity of the median depth, T = 1/2, is counted with the rest.

    Args:
        camera: The pinhole camera.
        means: World positions in scene units. Give all arguments in float64: rounding would hide them.
        quaternions: (w, x, y, z), any norm; zero is the identity.
        scales: Standard deviations in scene units, >= 0.
        opacities: Opacity of each Gaussian, in [0, 1].
        mode: "classic" or "antialiased", as given to the rasterizer.
        band: Relative half-width of a discontinuity, > 0.

    Returns: True at a discontinuity.

    Source: ours (spec: conventions, item 7).
    """
    flat = projection.project(camera, means, rotation.half_covariance(quaternions, scales))
    if mode == "antialiased":
        opacities = opacities * flat.compensation
    drawn = torch.where(flat.in_front)[0]
    order = drawn[torch.sort(flat.depths[drawn], stable=True).indices]
    group, tied = _tie_groups(flat.depths[order])
    rows, columns = torch.meshgrid(
        torch.arange(camera.height), torch.arange(camera.width), indexing="ij"
    )
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2).to(means) + 0.5
    marks = []
    for part in pixels.split(max(1, 2**22 // max(1, len(order)))):
        offsets = part[:, None] - flat.means[order]
        conics = flat.conics[order]
        power = -0.5 * torch.einsum("pni,nij,pnj->pn", offsets, conics, offsets)
        raw = (opacities[order] * power.exp()).clamp(max=compositing.ALPHA_MAX)
        alpha = torch.where(raw >= projection.ALPHA_MIN, raw, 0)
        after = (1 - alpha).cumprod(dim=1)
        reached = torch.cat([after.new_ones(len(part), 1), after[:, :-1]], dim=1) >= (
            compositing.T_MIN * (1 - band)
        )
        on_alpha = (raw / projection.ALPHA_MIN - 1).abs() <= band
        on_stop = ((after / compositing.T_MIN - 1).abs() <= band) & (alpha > 0)
        on_half = ((after / 0.5 - 1).abs() <= band) & (alpha > 0)
        shown = torch.zeros(len(part), len(tied)).index_add_(
            1, group, ((alpha > 0) & reached).float()
        )
        on_tie = ((shown > 1) & tied).any(dim=1)
        marks.append(((on_alpha | on_stop | on_half) & reached).any(dim=1) | on_tie)
    return torch.cat(marks).reshape(camera.height, camera.width)


def _tie_groups(depths: Float[Tensor, " n"]) -> tuple[Tensor, Bool[Tensor, " groups"]]:
    """Chains of sorted depths that float32 cannot tell apart, and which of them are not all equal."""
    ulp = depths.abs() * torch.finfo(torch.float32).eps
    gap = depths.diff(prepend=depths[:1])
    group = (gap > ulp).long().cumsum(dim=0)
    count = int(group[-1]) + 1 if len(group) else 0
    unequal = torch.zeros(count, dtype=torch.bool)
    unequal[group[(gap > 0) & (gap <= ulp)]] = True
    return group, unequal
