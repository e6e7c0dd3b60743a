"""Pictures of blocks: who owns what, who competes at their rims, how views are drawn, what SH cost."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from splatproof.methods.city.ground import ground
from splatproof.reference.compression import spectral
from splatproof.reference.partition import boxes, view_sampling
from splatproof.reference.partition import density_split as partition_density
from splatproof.reference.partition.density_split import DensitySettings
from splatproof.reference.partition.view_sampling import SamplingSettings
from splatproof.reference.stitching import stochastic as stitching
from splatproof.reference.stitching.stochastic import StitchSettings, TrainedBlock
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene
from splatproof.suites.gallery.drawing import COLOURS, panels, save, show_plan
from splatproof.suites.partition import partition_row, partitions

BLOCKS = 4


def draw_partitions(scene: Scene, path: Path) -> None:
    """Five partitions into four blocks from above, each block with its load over the mean.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    place = ground(scene)
    at = place.positions.numpy()
    low, high = np.quantile(at[:, :2], [0.005, 0.995], axis=0)
    figure, axes = panels(5, width=17.0, ratio=0.9)
    for axis, found in zip(axes, partitions(place, BLOCKS), strict=True):
        labels = found.labels.numpy()
        axis.scatter(at[:, 0], at[:, 1], s=0.4, c=np.array(COLOURS)[labels])
        mean = float(place.loads.sum()) / BLOCKS
        for block in range(BLOCKS):
            held = labels == block
            if held.any():
                share = float(place.loads[torch.from_numpy(held)].sum()) / mean
                axis.annotate(
                    f"{share:.2f}", np.median(at[held, :2], axis=0).tolist(), ha="center",
                    fontsize=9, bbox={"fc": "white", "ec": COLOURS[block], "pad": 1.5},
                )  # fmt: skip
        row = partition_row(place, found, BLOCKS)
        show_plan(axis, f"{found.method}: loads {row['load_std_over_mean']:.1%} std / mean, "
                        f"cut {row['edge_cut']}")  # fmt: skip
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(low[1], high[1])
    save(figure, path)


def trained_blocks(scene: Scene, margin: float = 0.15) -> tuple[TrainedBlock, ...]:
    """Blocks as if each had been trained alone: its points and a rim, shaken and of mixed opacity.

    Every block holds its own copy of the points in its widened box, moved by a hundredth of the
    box, with random opacities and scales.

    Args:
        scene: Scene whose sparse points the blocks hold.
        margin: Width of a rim as a share of the block's size.
    """
    place = ground(scene)
    settings = DensitySettings(max_points=0, max_depth=BLOCKS, max_blocks=BLOCKS)
    found = partition_density.split(place.positions[:, :2], settings)
    heights = partition_density.height_bounds(place.positions[:, 2])
    upright = torch.eye(3, dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    blocks = []
    for box in partition_density.oriented_boxes(found, upright, heights):
        held = boxes.box_distance(boxes.widen_oriented(box, margin), place.positions) <= 1
        count = int(held.sum())
        shake = 0.01 * box.half.min() * torch.randn(count, 3, generator=generator).double()
        size = torch.randn(count, 3, generator=generator).double() * 0.5
        blocks.append(
            TrainedBlock(
                box=box,
                means=place.positions[held] + shake,
                opacity_logits=2 * torch.randn(count, generator=generator).double(),
                log_scales=size + float((0.01 * box.half.mean()).log()),
            )
        )
    return tuple(blocks)


def draw_stitching(scene: Scene, path: Path) -> None:
    """Zones of four blocks, and what stays at their rims for a soft and a sharp competition.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    blocks = trained_blocks(scene)
    soft, sharp = StitchSettings(sharpness=5.0), StitchSettings(sharpness=500.0)
    middle = torch.cat([block.means for block in blocks]).median(dim=0).values
    half = 0.45 * torch.stack(
        [block.box.half for block in blocks if isinstance(block.box, boxes.OrientedBox)]
    ).mean(dim=0)
    figure, axes = panels(3, width=16.0, ratio=0.85)
    tints = (COLOURS[6], COLOURS[0], COLOURS[1])
    for block in blocks:
        zone = stitching.zones(block.box.distance(block.means))
        for which, tint in enumerate(tints):
            some = block.means[zone == which]
            axes[0].scatter(some[:, 0], some[:, 1], s=1.5, c=tint)
    show_plan(axes[0], "core grey, competitive blue, beyond 1.1 red")
    for axis, settings, name in ((axes[1], soft, "eta 5"), (axes[2], sharp, "eta 500")):
        kept = stitching.stitch(blocks, settings, torch.Generator().manual_seed(0))
        lost = 0
        for i, (block, stays) in enumerate(zip(blocks, kept, strict=True)):
            rim = stitching.zones(block.box.distance(block.means)) == 1
            gone, left = block.means[rim & ~stays], block.means[stays]
            lost += len(gone)
            axis.scatter(left[:, 0], left[:, 1], s=1.5, c=COLOURS[i])
            axis.scatter(gone[:, 0], gone[:, 1], s=3, c="black", marker="x", linewidths=0.4)
        show_plan(axis, f"{name}: kept in its block's colour, {lost} of the rims dropped (x)")
    for axis in axes:
        axis.set_xlim(float(middle[0] - half[0]), float(middle[0] + half[0]))
        axis.set_ylim(float(middle[1] - half[1]), float(middle[1] + half[1]))
    save(figure, path)


def draw_sampling(scene: Scene, path: Path) -> None:
    """Camera centres around the scene's middle by bin, and how often each is drawn.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    place = ground(scene)
    settings = SamplingSettings()
    centres = torch.stack([view.camera.centre for view in scene.train_views])
    middle = scene.points.positions.median(dim=0).values
    bins = view_sampling.view_bins(centres, middle, place.frame, settings)
    draws = view_sampling.balanced_draws(bins, settings, torch.Generator().manual_seed(0))
    total = 20 * len(centres)
    counts = np.bincount([next(draws) for _ in range(total)], minlength=len(centres))
    at = ((centres - middle) @ place.frame.T).numpy()
    figure, axes = panels(2, width=12.0, ratio=0.8)
    tint = [COLOURS[int(b) // settings.distances % len(COLOURS)] for b in bins]
    size = 20 + 40 * (bins % settings.distances).numpy()
    axes[0].scatter(at[:, 0], at[:, 1], s=size, c=tint)
    axes[0].plot([0], [0], "k+", markersize=14)
    show_plan(axes[0], "views by azimuth (colour) and distance (size) around the block")
    dots = axes[1].scatter(at[:, 0], at[:, 1], s=40, c=counts / 20, cmap="viridis")
    figure.colorbar(dots, ax=axes[1])
    show_plan(axes[1], "draws of each view over those of uniform sampling")
    save(figure, path)


def draw_spectrum(model: Gaussians, path: Path, *, gate: float = spectral.GATE) -> None:
    """Spectral energy of a trained model from above, its distribution, and what the gate drops.

    Args:
        model: Gaussians with harmonics of degree 1 to 3.
        path: PNG file to write.
        gate: Energy (the paper's gamma) below which harmonics are dropped, >= 0.
    """
    solid = model.opacities > 0.1
    model = replace(model, means=model.means[solid], sh=model.sh[solid])
    rest = model.sh[:, 1:].detach()
    energy = spectral.energy(rest).numpy()
    kept = spectral.open_gate(rest, gate).numpy()
    at = model.means.detach().numpy()
    low, high = np.quantile(at[:, :2], [0.01, 0.99], axis=0)
    figure, axes = panels(3, width=16.0, ratio=0.85)
    dots = axes[0].scatter(at[:, 0], at[:, 1], s=1, c=energy, cmap="viridis", vmin=0, vmax=3 * gate)
    figure.colorbar(dots, ax=axes[0])
    show_plan(axes[0], "spectral energy of each Gaussian, from above")
    axes[1].hist(energy, bins=np.linspace(0, 5 * gate, 80).tolist(), color=COLOURS[0])
    axes[1].axvline(gate, color=COLOURS[1])
    axes[1].set_title(
        f"distribution; the gate at {gate} closes for {1 - kept.mean():.0%}", fontsize=9
    )
    axes[2].scatter(at[kept, 0], at[kept, 1], s=1, c=COLOURS[6])
    axes[2].scatter(at[~kept, 0], at[~kept, 1], s=1, c=COLOURS[1])  # on top: they are fewer
    show_plan(axes[2], "view-dependent colour kept (grey), dropped (red)")
    for axis in (axes[0], axes[2]):
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(low[1], high[1])
    save(figure, path)
