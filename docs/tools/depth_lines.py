"""Depth of held-out views in lines: the truth above, what each row's model has below, near is bright."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float
from picture_lines import MOST
from strips import QUALITY, Image, line_of
from torch import Tensor

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.loading import load_reconstruction
from splatproof.reference.types.protocol import Protocol


def draw_depths(path: Path, scene: str, protocol: Protocol, folders: Mapping[str, Path]) -> None:
    """Write a picture, where the runs have the models of all its rows.

    Args:
        path: JPEG that is written.
        scene: Name of a scene whose true depth is known.
        protocol: Which of its views are held out.
        folders: A case's folder by what its line is called.
    """
    if not all((folder / "model").is_dir() for folder in folders.values()):
        return
    views = open_scene(scene, protocol).test_views[:MOST]
    truths = [view.load_depth() for view in views if view.load_depth is not None]
    scales = [float(truth[truth.isfinite()].min()) for truth in truths]
    lines = {"truth": truths}
    for row, folder in folders.items():
        model = load_reconstruction(folder / "model")
        with torch.no_grad():
            lines[row] = [model.render(view.without_truth()).depth for view in views]
    parts = []
    for row, depths in lines.items():
        tiles = [shaded(depth, nearest) for depth, nearest in zip(depths, scales, strict=True)]
        line = np.hstack(tiles)
        parts += [line_of(row, line.shape[1]), line]
    cv2.imwrite(str(path), np.vstack(parts), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def shaded(depth: Float[Tensor, "h w"], nearest: float) -> Image:
    """Inverse depth as colours, black where nothing is.

    Args:
        depth: In scene units; 0 or inf: nothing.
        nearest: Depth that is brightest.
    """
    inverse = torch.where(depth > 0, nearest / depth, 0.0).nan_to_num().clamp(0, 1)
    grey = (inverse.sqrt() * 255).byte().numpy()
    return np.asarray(cv2.applyColorMap(grey, cv2.COLORMAP_INFERNO), dtype=np.uint8)
