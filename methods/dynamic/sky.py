"""A sky infinitely far away: a cube of six learnt faces, looked up by the ray of each pixel."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from splatproof.datasets.image_cache import TensorCache
from splatproof.methods.dynamic.settings import SkySettings
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput

SKY = "sky"
"""Name of the shared tensor: six faces of r x r texels of three channels."""
RAY_BYTES = 2**28
"""Most bytes of looked-up places that are kept between steps: those of 36 cameras of 400x300. Of drives with more, each
round of the photos finds these."""


def started(settings: SkySettings) -> dict[str, Tensor]:
    """The shared tensor of a sky at its start; nothing where there is none.

    Args:
        settings: resolution and initial count.
    """
    side = settings.resolution
    return {SKY: torch.full((6, side, side, 3), settings.initial)} if side else {}


class Sky:
    """Draws the sky behind rendered images; where the pixels of a camera look is kept."""

    def __init__(self, covered: float = 1.0) -> None:
        """Start with no camera known.

        Args:
            covered: Alpha from which a pixel teaches the sky nothing; 1: every pixel teaches it.
        """
        self.covered = covered
        self._places = TensorCache(RAY_BYTES, drops=False)

    def behind(
        self, shared: Mapping[str, Tensor], camera: Camera, output: RenderOutput
    ) -> Float[Tensor, "h w 3"]:
        """colour + (1 - alpha) sky; the colours as they are where there is no sky.

        Pixels that are covered teach it nothing (ours). Else the little that shimmers through a street is
        painted on the sky behind it, in colours without bounds, for all to see from where the street
        was not photographed.

        Args:
            shared: Shared tensors of a model; the one named SKY counts.
            camera: What was rendered from.
            output: Colours over the background, which stays behind the sky: black for most
                protocols.

        Source: Chen et al. 2023, "Periodic Vibration Gaussian", Sec. 3.3.
        """
        if SKY not in shared:
            return output.colour
        sky = self.image(shared[SKY], camera)
        sky = torch.where((output.alpha < self.covered)[..., None], sky, sky.detach())
        return output.colour + (1 - output.alpha)[..., None] * sky

    def image(self, cube: Float[Tensor, "6 r r 3"], camera: Camera) -> Float[Tensor, "h w 3"]:
        """The sky alone, differentiable by its texels.

        Args:
            cube: The six faces.
            camera: Its rotation and intrinsics count: the sky is as far away from everywhere.
        """
        side, device = cube.shape[1], cube.device
        packed = self._places.get(
            (camera, side, device), lambda: _packed(*places(camera, side), 6 * side**2).to(device)
        )
        colours = _Looked.apply(cube.reshape(-1, 3), packed)
        assert isinstance(colours, Tensor)
        return colours.reshape(camera.height, camera.width, 3)


class _Looked(torch.autograd.Function):
    """Weighted sums of texels, and back: each texel's gradient is a weighted sum of pixels.

    Torch's own gradient of indexing adds pixel by pixel, which takes 5 to 15 times as long.
    """

    @staticmethod
    def forward(ctx: Any, texels: Tensor, packed: Tensor) -> Tensor:
        ctx.count, ctx.packed = len(texels), packed
        index, share = packed[: -ctx.count].reshape(4, -1, 4)[:2]
        return functional.embedding_bag(
            index, texels, mode="sum", per_sample_weights=share.view(torch.float32).to(texels)
        )

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, None]:
        pixel, share = ctx.packed[: -ctx.count].reshape(4, -1)[2:]
        back = functional.embedding_bag(
            pixel, grad_outputs[0], ctx.packed[-ctx.count :], mode="sum",
            per_sample_weights=share.view(torch.float32).to(grad_outputs[0]),
        )  # fmt: skip
        return back, None


def _packed(texels: Tensor, shares: Tensor, count: int) -> Tensor:
    """Texels and shares by pixel, pixels and shares by texel, and where each texel's pixels begin.

    One tensor of int32, so that a bounded memory keeps or drops them together.
    """
    order = in_order(texels.reshape(-1), count)
    begins = texels.reshape(-1).bincount(minlength=count).cumsum(0).roll(1)
    begins[0] = 0
    parts = (texels, shares.view(torch.int32), order // 4, shares.view(-1)[order].view(torch.int32))
    return torch.cat([part.reshape(-1).int() for part in (*parts, begins)])


def in_order(values: Int[Tensor, " n"], count: int) -> Int[Tensor, " n"]:
    """The stable order of some numbers: those of 16 bits are sorted by their digits, which is several times as fast.

    Args:
        values: At least 0 and below `count`.
        count: Above all of them.
    """
    short = np.uint16 if count <= 2**16 else np.int64
    return torch.from_numpy(np.argsort(values.numpy().astype(short), kind="stable"))


def places(camera: Camera, side: int) -> tuple[Int[Tensor, "p 4"], Float[Tensor, "p 4"]]:
    """The four texels around where each pixel's ray meets the cube, and each one's share.

    Args:
        camera: The pinhole camera.
        side: Texels along an edge of a face.

    Returns: Indices into the texels of all faces, one after the other; shares, which sum to 1. Rows
        of pixels come one after the other.
    """
    rows = torch.arange(camera.height, dtype=torch.float64) + 0.5
    columns = torch.arange(camera.width, dtype=torch.float64) + 0.5
    y, x = torch.meshgrid(rows, columns, indexing="ij")
    pixels = torch.stack([x, y, torch.ones_like(x)], dim=-1).reshape(-1, 3)
    matrix = camera.K.double().inverse().T @ camera.rotation.double()
    return around(pixels @ matrix, side)


def around(
    directions: Float[Tensor, "p 3"], side: int
) -> tuple[Int[Tensor, "p 4"], Float[Tensor, "p 4"]]:
    """The four texels around where each direction meets the cube, and each one's share.

    A texel beyond the edge of a face is the one across the edge, so that colours have no step there;
    at a corner, where three faces meet, those three share what a fourth would have.

    Args:
        directions: Vectors of any length but zero, in the scene's frame.
        side: Texels along an edge of a face.

    Source: ours, as graphics hardware does it ("seamless cube maps").
    """
    face, place = on_cube(directions)
    at = (place + 1) / 2 * side - 0.5
    low = at.floor()
    part = at - low
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]).to(at)
    shares = torch.where(corners.bool(), part[:, None], 1 - part[:, None]).prod(dim=-1)
    cells = low[:, None] + corners
    outside = (cells < 0) | (cells >= side)
    texels = ((face[:, None] * side + cells[..., 1]) * side + cells[..., 0]).long()
    # Over an edge: the direction of the texel's place along the edge, a hair beyond it.
    row, corner = torch.where(outside.any(dim=-1))
    centres, over = (cells[row, corner] + 0.5) * 2 / side - 1, outside[row, corner]
    beyond = torch.where(over, centres.sign() * (1 + 1e-3 / side), centres)
    other, there = on_cube(off_cube(face[row], beyond))
    cell = ((there + 1) / 2 * side).floor().clamp(0, side - 1).long()
    texels[row, corner] = (other * side + cell[:, 1]) * side + cell[:, 0]
    lost = outside.all(dim=-1)
    shared_out = torch.where(lost, shares, 0).sum(dim=-1, keepdim=True) / 3
    gains = torch.where(lost.any(dim=-1, keepdim=True), shared_out, 0)
    return texels, torch.where(lost, 0, shares + gains).float()


def on_cube(directions: Float[Tensor, "p 3"]) -> tuple[Int[Tensor, " p"], Float[Tensor, "p 2"]]:
    """Face that each direction meets (+x, -x, +y, -y, +z, -z) and where, in [-1, 1]^2.

    Args:
        directions: Vectors of any length but zero.
    """
    axis = directions.abs().argmax(dim=1)
    along = directions.gather(1, axis[:, None])
    others = torch.tensor([[1, 2], [0, 2], [0, 1]])[axis]
    return 2 * axis + (along[:, 0] < 0), directions.gather(1, others) / along.abs()


def off_cube(face: Int[Tensor, " p"], place: Float[Tensor, "p 2"]) -> Float[Tensor, "p 3"]:
    """Directions of places on the cube: the inverse of `on_cube`.

    Args:
        face: Number of each face.
        place: Where on it; beyond [-1, 1]^2 is in the face's plane outside of it.
    """
    axis = face // 2
    others = torch.tensor([[1, 2], [0, 2], [0, 1]])[axis]
    sign = (1 - 2 * (face % 2)).to(place)
    directions = place.new_zeros(len(place), 3).scatter_(1, axis[:, None], sign[:, None])
    return directions.scatter(1, others, place)
