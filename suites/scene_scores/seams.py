"""Seams of a model that was made of blocks, scored view by view: on the paper's mask, the partition's and the release's."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol as Shape
from typing import runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from splatproof.base.folders import new_folder
from splatproof.datasets.photos import write_png
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.kernels import blocks as kernels
from splatproof.metrics.scoring import round_to_8_bit
from splatproof.metrics.seam import SeamSums, SeamView, seam_scores, seam_sums
from splatproof.metrics.seam_partition import partition_seam_mask
from splatproof.metrics.seam_released import seam_scores_released
from splatproof.metrics.seam_render import render_seam_view
from splatproof.reference.partition.boxes import Region
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import picture_name
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.scene_scores.released_seams import boxes_of, released_scores
from splatproof.suites.scene_scores.surface import surface_depth

PARTITION = "_partition"
"""End of the names of what is scored on the partition's mask."""
COLOURS = (
    (68, 119, 170), (238, 102, 119), (34, 136, 51), (204, 187, 68),
    (102, 204, 238), (170, 51, 119), (187, 187, 187), (90, 60, 30),
)  # fmt: skip
"""sRGB of blocks in pictures; block k has colour k modulo their number."""


@runtime_checkable
class Blocked(Shape):
    """A reconstruction whose Gaussians belong to the blocks of a partition."""

    @property
    def blocks(self) -> Int[Tensor, " n"]:
        """Block of each Gaussian."""
        ...

    @property
    def distances(self) -> Float[Tensor, " n"]:
        """Normalised distance of each Gaussian to its own block's region."""
        ...

    @property
    def regions(self) -> Sequence[Region]:
        """Where each block of the partition lies, in the scene's frame."""
        ...

    @property
    def mode(self) -> Mode:
        """How the model is rasterized."""
        ...

    def bake(self, view: View | None = None) -> Gaussians:
        """The Gaussians, in the scene's frame.

        Args:
            view: Whose camera, time and appearance count; None where the model needs none.
        """
        ...


def score_seams(
    scene: Scene, model: Blocked, protocol: Protocol, backend: str, folder: Path
) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """The seam metrics of every test view, and over all of them together.

    The paper's four pool the seam pixels of all views. They stand under the paper's names on its own
    mask, which is empty where a merge kept nothing beyond its own block, and as `*_partition` on the
    mask that asks the partition alone: the one over which all merges can be compared. Where the blocks
    are boxes, those of the paper's release stand beside them (suites/scene_scores/released_seams.py).

    Writes seams/ (the render, pixels on the partition's seams in red) and blocks/ (each pixel in the colours of the
    blocks that it is composited from, in their shares) as PNGs named after the views.

    Args:
        scene: The scene, with its test views.
        model: The model that is scored.
        protocol: The rules; background, rounding and mask are applied as for every other metric.
        backend: Name of the rasterizer.
        folder: Folder of the case.
    Returns: View name to its metrics, and the scene's. nan where no seam pixel is.
    """
    views, released = {}, []
    sums: dict[str, list[SeamSums]] = {"": [], PARTITION: []}
    boxes = boxes_of(model.regions)
    with new_folder(folder / "seams") as masks, new_folder(folder / "blocks") as coloured:
        for index in sorted(scene.test, key=lambda i: scene.views[i].name):
            view = scene.views[index]
            kept, seen = seam_views(scene, index, model, protocol, backend)
            for suffix, one in (("", kept), (PARTITION, seen)):
                sums[suffix].append(seam_sums(one))
            views[view.name] = _scores({suffix: found[-1:] for suffix, found in sums.items()})
            if boxes:
                released.append(released_scores(view, seen, boxes, masked=protocol.masked))
                views[view.name] |= released[-1].values
            name = picture_name(view.name)
            write_png(masks / name, mask_picture(seen.image, seen.seam))
            write_png(coloured / name, block_picture(seen.block_weights))
    whole = _scores(sums)
    return views, whole | seam_scores_released(released).values if boxes else whole


def _scores(sums: Mapping[str, Sequence[SeamSums]]) -> dict[str, float]:
    """The paper's four over some views, each name followed by the suffix of its mask."""
    return {
        f"{name}{suffix}": value
        for suffix, found in sums.items()
        for name, value in seam_scores(found).values.items()
    }


def seam_views(
    scene: Scene, index: int, model: Blocked, protocol: Protocol, backend: str
) -> tuple[SeamView, SeamView]:
    """One test view with the paper's seam mask and with the partition's; masked pixels are on no seam.

    Args:
        scene: The scene; its true depth or sparse points say where the surface is.
        index: Index of the view in scene.views.
        model: The model that is scored.
        protocol: The rules; background, rounding and mask count.
        backend: Name of the rasterizer.
    """
    view = scene.views[index]
    native = backend == "cpu"
    seen = render_seam_view(
        partial(get_backend(backend).rasterize, mode=model.mode), view.camera, model.bake(view),
        model.blocks, model.distances, view.load(), torch.tensor(protocol.background),
        render_blocks=partial(kernels.render_blocks, mode=model.mode) if native else None,
        block_weights=partial(kernels.block_weights, mode=model.mode) if native else None,
    )  # fmt: skip
    seen = replace(seen, image=round_to_8_bit(seen.image, protocol.rounding))
    own = partition_seam_mask(view.camera, surface_depth(scene, index), model.regions)
    masks = (seen.seam, own)
    if view.load_mask is not None and protocol.masked:
        counted = view.load_mask()
        masks = tuple(mask & counted for mask in masks)
    kept, by_partition = (replace(seen, seam=mask) for mask in masks)
    return kept, by_partition


def mask_picture(
    image: Float[Tensor, "h w 3"], seam: Bool[Tensor, "h w"]
) -> UInt8[np.ndarray, "h w 3"]:
    """The image with the seam's pixels half red.

    Args:
        image: Render of a view, in [0, 1].
        seam: Which pixels lie on a seam.

    Returns: The picture in 8 bits.
    """
    red = torch.tensor([1.0, 0.0, 0.0])
    shown = torch.where(seam[..., None], 0.5 * image + 0.5 * red, image)
    return (shown * 255).round().to(torch.uint8).numpy()


def block_picture(weights: Float[Tensor, "h w b"]) -> UInt8[np.ndarray, "h w 3"]:
    """Each pixel in the colours of its blocks, mixed by their compositing weights."""
    colours = torch.tensor(COLOURS, dtype=weights.dtype)[
        torch.arange(weights.shape[2]) % len(COLOURS)
    ]
    return (weights.clamp(0, 1) @ colours).clamp(0, 255).round().to(torch.uint8).numpy()
