"""Pictures of a model whose Gaussians belong to blocks: each block alone, and each block's share of the whole."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.rasterizer import (
    MAX_CHANNELS,
    check_background,
    check_model,
    native_camera,
    plain,
    rasterize,
)
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockRenders:
    """What `rasterize` gives for each block's Gaussians alone, to the bit."""

    colours: Float[Tensor, "b h w 3"]
    """Colours of each block over the background; not clamped."""
    alphas: Float[Tensor, "b h w"]
    """1 - final transmittance of each block, in [0, 1)."""
    depths: Float[Tensor, "b h w"]
    """Expected z-depth of each block in scene units; 0 where it draws nothing."""


def render_blocks(
    camera: Camera,
    gaussians: Gaussians,
    blocks: Int[Tensor, " n"],
    count: int,
    *,
    background: Float[Tensor, "3"] | None = None,
    mode: Mode = "classic",
) -> BlockRenders:
    """Render each block alone; projection and sort are shared.

    Args:
        camera: The pinhole camera of the view.
        gaussians: The whole model, float32 on the CPU.
        blocks: Block of each Gaussian, 0 to count - 1.
        count: Number of blocks, at least 1; one without Gaussians shows the background.
        background: Colour behind each block; None is black.
        mode: How they are rasterized, as in rasterize.

    Raises: ValueError if a block is out of range or the Gaussians are not what the kernels read.

    Source: ours.
    """
    if count < 1:
        raise ValueError(f"count is {count}, expected at least 1")
    values = [
        plain(v)
        for v in (gaussians.means, gaussians.quaternions, gaussians.scales, gaussians.opacities)
    ]
    means, quaternions, scales, opacities = (v for v in values if v is not None)
    sh = gaussians.sh.detach().contiguous()
    check_background(background, 3)
    check_model(means, quaternions, scales, opacities, None, sh)
    model = _ext.Model(
        means, quaternions, scales, opacities, None, sh, sh.shape[1], False, mode == "antialiased"
    )
    size = (count, camera.height, camera.width)
    colours, alphas, depths = torch.empty(*size, 3), torch.empty(size), torch.empty(size)
    use_threads()
    _ext.render_blocks(
        model, *native_camera(camera), plain(background), blocks.long().contiguous(), colours, alphas,
        depths,
    )  # fmt: skip
    return BlockRenders(colours=colours, alphas=alphas, depths=depths)


@torch.no_grad()
def block_weights(
    camera: Camera,
    gaussians: Gaussians,
    blocks: Int[Tensor, " n"],
    count: int,
    *,
    mode: Mode = "classic",
) -> Float[Tensor, "h w b"]:
    """Share of each block in the composited pixel: the sum of its Gaussians' weights; all add up to alpha.

    Args:
        camera: The pinhole camera of the view.
        gaussians: The whole model, float32 on the CPU.
        blocks: Block of each Gaussian, 0 to count - 1.
        count: Number of blocks, at least 1; 32 are drawn in one pass.
        mode: How they are rasterized, as in rasterize.

    Raises: ValueError as rasterize.

    Source: ours.
    """
    shares = []
    for first in range(0, count, MAX_CHANNELS):
        some = torch.arange(first, min(first + MAX_CHANNELS, count))
        membership = (blocks[:, None] == some).to(torch.float32)
        picture = rasterize(
            camera, gaussians.means, gaussians.quaternions, gaussians.scales, gaussians.opacities,
            colours=membership, mode=mode,
        )  # fmt: skip
        shares.append(picture.colour)
    return torch.cat(shares, dim=-1)
