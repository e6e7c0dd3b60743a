"""What the seam metrics look at, rendered from a model whose Gaussians belong to blocks."""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.metrics.seam import TOP, SeamView, overlap_band, seam_mask
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.render import RenderOutput


class BlockPictures(Protocol):
    """Pictures of each block's Gaussians alone, as `render_blocks` returns them."""

    @property
    def colours(self) -> Float[Tensor, "b h w 3"]:
        """Colour over the background; not clamped."""
        ...

    @property
    def depths(self) -> Float[Tensor, "b h w"]:
        """z-depth in scene units; 0 where nothing is drawn."""
        ...


def render_seam_view(
    rasterize: Callable[..., RenderOutput],
    camera: Camera,
    gaussians: Gaussians,
    blocks: Int[Tensor, " n"],
    distances: Float[Tensor, " n"],
    truth: Float[Tensor, "h w 3"],
    background: Float[Tensor, "3"] | None = None,
    *,
    render_blocks: Callable[..., BlockPictures] | None = None,
    block_weights: Callable[..., Tensor] | None = None,
) -> SeamView:
    """Render the whole model, each block's share of it, and each block alone.

    Args:
        rasterize: Rasterizer of any backend, with the signature of
            splatproof.reference.rasterizer.rasterize.
        camera: Camera of the test view.
        gaussians: The merged model, all blocks together.
        blocks: Block of each Gaussian, 0 to b - 1.
        distances: Normalised distance of each Gaussian to the oriented box of its own block.
        truth: The test image, in [0, 1].
        background: Colour behind everything, also behind a single block; None is black.
        render_blocks: Called as render_blocks(camera, gaussians, blocks, count, background=...):
            every block alone, in one pass where a backend has one; None: a pass each.
        block_weights: Called as block_weights(camera, gaussians, blocks, count): each block's share
            of every pixel, for backends with a bound on channels; None: one channel a block.
    Returns: Colours clamped to [0, 1]; depths are 0 where nothing is drawn.
    """
    count = int(blocks.max()) + 1 if len(blocks) else 1

    def render(part: Gaussians, **options: object) -> RenderOutput:
        return rasterize(
            camera, part.means, part.quaternions, part.scales, part.opacities, **options
        )

    with torch.no_grad():
        whole = render(gaussians, sh=gaussians.sh, background=background, contributors=TOP)
        if block_weights is None:
            membership = torch.nn.functional.one_hot(blocks.long(), count).to(gaussians.means)
            weights = render(gaussians, colours=membership).colour
        else:
            weights = block_weights(camera, gaussians, blocks, count)
        if render_blocks is None:
            parts = [_select(gaussians, blocks == block) for block in range(count)]
            alone = [render(part, sh=part.sh, background=background) for part in parts]
            colours = torch.stack([output.colour for output in alone])
            depths = torch.stack([output.depth for output in alone])
        else:
            pictures = render_blocks(camera, gaussians, blocks, count, background=background)
            colours, depths = pictures.colours, pictures.depths
    assert whole.contributor_ids is not None
    return SeamView(
        image=whole.colour.clamp(0, 1),
        truth=truth,
        depth=whole.depth,
        seam=seam_mask(whole.contributor_ids, overlap_band(distances), blocks),
        block_weights=weights,
        block_images=colours.clamp(0, 1),
        block_depths=depths,
    )


def _select(gaussians: Gaussians, chosen: Tensor) -> Gaussians:
    return replace(
        gaussians,
        means=gaussians.means[chosen],
        quaternions=gaussians.quaternions[chosen],
        log_scales=gaussians.log_scales[chosen],
        opacity_logits=gaussians.opacity_logits[chosen],
        sh=gaussians.sh[chosen],
    )
