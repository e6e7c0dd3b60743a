"""Matcher `roma`: the networks of package romatch, whole or tiny, from a local folder. Nothing is fetched."""

import importlib
import warnings
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor, nn
from torch.nn import functional

from splatproof.base.errors import DataError, MissingError
from splatproof.base.files import size_of
from splatproof.base.memory import check_room

WHOLE, TINY = "roma_*.pth", "tiny_roma_v1_*.pth"
"""Files of weights as their authors name them."""
BACKBONE = "dinov2_vitl14_pretrain.pth"
"""What lies beside the weights of the whole network: those of DINOv2, which it sees with."""
LONGEST = 1024
"""Most pixels of the longer side that the tiny network sees: it was trained on 1024 x 768, and its memory grows with
the fourth power of this (0.6 GB at 1024 x 768). The whole one brings every photo to 560 x 560 and 864 x 864."""
SHORTEST = 32
"""Least pixels of a side: the tiny network looks at whole multiples of this."""
XFEAT = {
    "block1": ((1, 4, 1, 3), (4, 8, 2, 3), (8, 8, 1, 3), (8, 24, 2, 3)),
    "block2": ((24, 24, 1, 3), (24, 24, 1, 3)),
    "block3": ((24, 64, 2, 3), (64, 64, 1, 3), (64, 64, 1, 1)),
    "block4": ((64, 64, 2, 3), (64, 64, 1, 3), (64, 64, 1, 3)),
    "block5": ((64, 128, 2, 3), (128, 128, 1, 3), (128, 128, 1, 3), (128, 64, 1, 1)),
    "block_fusion": ((64, 64, 1, 3), (64, 64, 1, 3)),
}
"""Layers of XFeat, which the tiny network sees with: channels before and after, stride, width of the kernel."""
INSTEAD = "match photos by --dense.matcher flow, which needs none"


class RomaMatcher:
    """A DenseMatcher: one network for all pairs and threads, which wait for one another."""

    def __init__(self, network: Any, *, longest: int | None = None) -> None:
        """Take a network.

        Args:
            network: Its match(A, B) of two PIL images returns a warp (positions in A and in B, x and y each, from -1 to
                1 between the images' edges) and a certainty from 0 to 1, of a grid on A of any size.
            longest: Pixels of the longer side that it sees, at most; None: it makes photos smaller itself.
        """
        self._network, self._longest = network, longest
        self._alone = Lock()

    def __call__(
        self, image_a: Float[Tensor, "h w 3"], image_b: Float[Tensor, "hb wb 3"]
    ) -> tuple[Float[Tensor, "h w 2"], Float[Tensor, "h w"]]:
        """The warp W with u_B = u_A + W(u_A) in pixels, and certainty in [0, 1].

        Args:
            image_a: The photo that is matched at every pixel, sRGB in [0, 1].
            image_b: The other photo, of any size.

        Source: Edstedt et al. 2024, "RoMa: Robust Dense Feature Matching", through romatch.
        """
        pictures = [picture(image, self._longest) for image in (image_a, image_b)]
        with self._alone:  # what a pair takes is not multiplied by threads
            warp, sure = self._network.match(*pictures)
        # the whole network returns a batch, the tiny one does not
        grid, sure = warp.reshape(warp.shape[-3:]), sure.reshape(sure.shape[-2:])
        (height, width, _), (high, wide, _) = image_a.shape, image_b.shape
        return in_pixels(grid, sure, (height, width), (high, wide))


def picture(image: Float[Tensor, "h w 3"], longest: int | None) -> Image.Image:
    """A photo as the networks take it, its sides at least SHORTEST.

    Args:
        image: sRGB in [0, 1].
        longest: Most pixels of the longer side; None: it keeps them all.
    """
    levels = (image.clamp(0, 1) * 255).round().byte().cpu().numpy()
    made = Image.fromarray(np.ascontiguousarray(levels))
    scale = min(1.0, (longest or max(made.size)) / max(made.size))
    width, height = (max(SHORTEST, round(scale * side)) for side in made.size)
    return made.resize((width, height), Image.Resampling.BICUBIC)


def in_pixels(
    warp: Float[Tensor, "g k 4"],
    certainty: Float[Tensor, "g k"],
    size_a: tuple[int, int],
    size_b: tuple[int, int],
) -> tuple[Float[Tensor, "h w 2"], Float[Tensor, "h w"]]:
    """The warp W with u_B = u_A + W(u_A) in pixels of the photos, and certainty, of each pixel of A.

    A position n from -1 to 1 is u = (n + 1) s / 2 of s pixels: the first pixel's middle is u = 0.5. What is
    interpolated between the grid's nodes is W, which changes little beyond the outermost ones: they lie half a cell
    inside the edge. Where W leads out of B, nothing is certain.

    Args:
        warp: Positions in A and in B at the middles of a grid's cells, x and y each, -1 to 1 between edges.
        certainty: How sure each is, in [0, 1].
        size_a: Height and width of photo A in pixels.
        size_b: Height and width of photo B in pixels.
    """
    sizes = torch.tensor([*size_a[::-1], *size_b[::-1]], dtype=torch.float64)
    here, there = ((warp.double() + 1) / 2 * sizes).split(2, dim=-1)
    maps = torch.cat([there - here, certainty[..., None].double()], dim=-1).permute(2, 0, 1)
    fine = functional.interpolate(maps[None], size_a, mode="bilinear", align_corners=False)[0]
    rows, columns = torch.meshgrid(torch.arange(size_a[0]), torch.arange(size_a[1]), indexing="ij")
    landed = torch.stack([columns, rows]) + 0.5 + fine[:2]
    inside = ((landed >= 0) & (landed < sizes[2:, None, None])).all(dim=0)
    return fine[:2].permute(1, 2, 0).float(), (fine[2].clamp(0, 1) * inside).float()


def load_matcher(folder: Path) -> RomaMatcher:
    """Read the weights of a folder, on the processor.

    Args:
        folder: It holds tiny_roma_v1_outdoor.pth, or roma_outdoor.pth (or roma_indoor.pth) and
            dinov2_vitl14_pretrain.pth, as their authors give them.
    Raises: MissingError without the package or a file; DataError for a folder or file that holds something else.
    """
    if not folder.is_dir():
        raise MissingError(
            f"{folder}: no such folder of weights, which dense.matcher 'roma' needs; give one that is here by "
            f"--dense.weights, or {INSTEAD}"
        )
    found = [*folder.glob(WHOLE), *folder.glob(TINY)]
    if len(found) != 1:
        held = ", ".join(sorted(path.name for path in found)) or "no weights of RoMa"
        raise DataError(
            f"{folder}: holds {held}; expected tiny_roma_v1_outdoor.pth, or roma_outdoor.pth with {BACKBONE} beside it, "
            "as their authors give them; nothing is fetched"
        )
    (path,) = found
    library = _library()
    if path.match(TINY):
        return RomaMatcher(_tiny(library, path), longest=LONGEST)
    return RomaMatcher(_whole(library, path, folder / BACKBONE))


def _library() -> Any:
    """Package romatch, silent."""
    try:
        library = importlib.import_module("romatch")
        importlib.import_module("loguru").logger.disable("romatch")
    except (
        ImportError,
        RuntimeError,
    ) as error:  # a torchvision of another build than torch's: RuntimeError
        said = " ".join(str(error).split())[:200]
        raise MissingError(
            f"dense.matcher 'roma' needs the package romatch, which cannot be imported ({said}): install "
            f"splatproof[priors], then `pip install --no-deps romatch` (docs/depth_priors.md), or {INSTEAD}"
        ) from None
    return library


def _tiny(library: Any, path: Path) -> Any:
    """TinyRoMa; its file holds the weights of XFeat, too."""
    layer = importlib.import_module("romatch.models.tiny").BasicLayer
    try:
        return library.tiny_roma_v1_outdoor(
            torch.device("cpu"), weights=_weights(path), xfeat=_xfeat(layer)
        ).eval()
    except (RuntimeError, TypeError, AttributeError) as error:
        raise _unlike(path, error) from None


def _whole(library: Any, path: Path, backbone: Path) -> Any:
    """RoMa, matching A to B alone, in float32: the processor has no faster arithmetic for it."""
    weights, seeing = _weights(path), _weights(backbone)
    try:
        with warnings.catch_warnings():  # it changes the filters
            return library.roma_outdoor(
                torch.device("cpu"), weights=weights, dinov2_weights=seeing, symmetric=False,
                use_custom_corr=False, amp_dtype=torch.float32,
            ).eval()  # fmt: skip
    except (RuntimeError, TypeError, AttributeError) as error:
        raise _unlike(path, error) from None


def _xfeat(layer: Any) -> nn.Module:
    """XFeat without weights and without its heads, which TinyRoMa removes.

    Source: Potje et al. 2024, "XFeat: Accelerated Features for Lightweight Image Matching", Sec. 3.
    """
    made = nn.Module()
    made.norm = nn.InstanceNorm2d(1)
    made.skip1 = nn.Sequential(nn.AvgPool2d(4, stride=4), nn.Conv2d(1, 24, 1))
    for name, layers in XFEAT.items():
        block = [
            layer(before, after, kernel_size=width, stride=stride, padding=width // 2)
            for before, after, stride, width in layers
        ]
        last = [nn.Conv2d(64, 64, 1)] if name == "block_fusion" else []
        setattr(made, name, nn.Sequential(*block, *last))
    for head in ("heatmap_head", "keypoint_head", "fine_matcher"):
        setattr(made, head, nn.Identity())
    return made


def _weights(path: Path) -> Any:
    """Tensors by name of a file that torch wrote; nothing in it is run."""
    try:
        size = size_of(path, MissingError)
    except MissingError as error:
        raise MissingError(f"{error}, which dense.matcher 'roma' needs; or {INSTEAD}") from None
    check_room(path, 2 * size)  # once as they are read, once in the network
    try:
        held = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # noqa: BLE001 (torch raises whatever its unpickler meets)
        raise _unlike(path, error) from None
    if not isinstance(held, dict):  # romatch would fetch others in place of None
        raise _unlike(path, TypeError(f"it holds a {type(held).__name__}"))
    return held


def _unlike(path: Path, error: Exception) -> DataError:
    said = " ".join(str(error).split())[:200]
    return DataError(
        f"{path}: not the weights that are expected ({said}); take the file from its authors again, or {INSTEAD}"
    )
