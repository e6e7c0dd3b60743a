"""Pictures of what happens between anchors: attention, support, motion; and of dense points."""

from pathlib import Path

import numpy as np
import torch
from matplotlib.patches import Circle

from splatproof.reference.anchors import attention as anchor_attention
from splatproof.reference.anchors import motion_hierarchy as mh
from splatproof.reference.anchors import scaffold as anchors
from splatproof.reference.anchors import support_network
from splatproof.reference.anchors.sparse_convolution import neighbours, voxelise
from splatproof.reference.supervision import dense_initialisation
from splatproof.reference.supervision.dense_matching import match_by_flow, plane_between
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene
from splatproof.suites.gallery.drawing import COLOURS, panels, save, show_image, show_plan


def _anchors_of(scene: Scene, count: int) -> tuple[torch.Tensor, float]:
    """About `count` voxel centres of the scene's points, and the voxel size that gives them."""
    points = scene.points.positions
    low, high = points.quantile(0.02, dim=0), points.quantile(0.98, dim=0)
    points = points[((points >= low) & (points <= high)).all(dim=1)]
    voxel = float((high - low).norm()) / 4
    while len(anchors.anchor_voxels(points, voxel)) < count:
        voxel *= 0.8
    return anchors.anchor_voxels(points, voxel), voxel


def draw_attention(scene: Scene, path: Path) -> None:
    """Whom three anchors attend to within the radius, and how strongly.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    centres, voxel = _anchors_of(scene, 400)
    place = anchor_attention.in_box(centres, centres.amin(dim=0), centres.amax(dim=0))
    inputs = anchor_attention.fourier_code(place)
    weights = anchor_attention.create(24, 16, torch.Generator().manual_seed(0), torch.float64)
    gated = anchor_attention.pooled_gates(inputs, weights)
    radius = 4 * voxel
    picked = [len(centres) // 5, len(centres) // 2, 4 * len(centres) // 5]
    figure, axes = panels(3, width=13.0, ratio=0.8)
    for axis, i in zip(axes, picked, strict=True):
        shares = _attention_row(gated, centres, radius, weights, i)
        axis.scatter(centres[:, 0], centres[:, 1], s=4, c="#dddddd")
        seen = shares > 0
        dots = axis.scatter(
            centres[seen, 0], centres[seen, 1], s=18, c=shares[seen], cmap="viridis"
        )
        axis.add_patch(
            Circle(
                (float(centres[i, 0]), float(centres[i, 1])), radius, fill=False, color=COLOURS[1]
            )
        )
        axis.plot([float(centres[i, 0])], [float(centres[i, 1])], "x", color=COLOURS[1])
        figure.colorbar(dots, ax=axis, shrink=0.8)
        show_plan(axis, f"anchor {i} attends to {int(seen.sum())} of {len(centres)}")
    save(figure, path)


def _attention_row(
    gated: torch.Tensor,
    centres: torch.Tensor,
    radius: float,
    weights: anchor_attention.AttentionWeights,
    row: int,
) -> torch.Tensor:
    """Attention weights of one anchor: its output when each anchor's value marks itself."""
    marks = torch.eye(len(centres), dtype=gated.dtype)
    # Queries and keys read the features, values the marks: append the marks as further inputs.
    none = gated.new_zeros(len(centres), weights.query.shape[1])
    marked = anchor_attention.AttentionWeights(
        anchor_kernel=weights.anchor_kernel, feature_kernel=weights.feature_kernel,
        query=torch.cat([weights.query, none]), key=torch.cat([weights.key, none]),
        value=torch.cat([gated.new_zeros(gated.shape[1], len(centres)), marks]),
    )  # fmt: skip
    both = torch.cat([gated, marks], dim=1)
    return anchor_attention.local_attention(both, centres, radius, marked)[row]


def draw_support(scene: Scene, path: Path) -> None:
    """Occupied voxels by how many neighbours they have, and alignment with the principal axis.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    centres, voxel = _anchors_of(scene, 900)
    around = neighbours(voxelise(centres + voxel / 2, voxel))  # centres lie on multiples
    count = (around >= 0).sum(dim=1) - 1
    quaternions = torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64).expand(len(centres), 4)
    scales = torch.tensor([[3.0, 1, 1]], dtype=torch.float64).expand(len(centres), 3) * voxel
    along = support_network.alignment(centres, quaternions, scales, around)
    best = int(count.argmax())
    figure, axes = panels(2, width=12.0, ratio=0.8)
    dots = axes[0].scatter(centres[:, 0], centres[:, 1], s=12, c=count, cmap="viridis")
    figure.colorbar(dots, ax=axes[0])
    show_plan(axes[0], "occupied neighbours of each anchor (of 26)")
    members = around[best][around[best] >= 0]
    dots = axes[1].scatter(centres[members, 0], centres[members, 2], s=120,
                           c=along[best][around[best] >= 0], cmap="viridis", vmin=0, vmax=1)  # fmt: skip
    figure.colorbar(dots, ax=axes[1])
    axes[1].plot([float(centres[best, 0])], [float(centres[best, 2])], "x", color=COLOURS[1])
    show_plan(axes[1], "side view of one neighbourhood: alignment with a long x axis")
    save(figure, path)


def draw_hierarchy(scene: Scene, path: Path) -> None:
    """Paths of one anchor, its sub-anchors' Gaussians, and their opacity over time.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    del scene  # motion is drawn on anchors of its own
    settings = mh.HierarchySettings(features=8, instance=4, period=4.0)
    generator = torch.Generator().manual_seed(3)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    stored = mh.MotionAnchors(
        centres=torch.tensor([[0.0, 0, 0], [3, 1, 0]], dtype=torch.float64), features=draw(2, 8),
        instances=draw(2, 4), quaternions=draw(2, 4),
        log_scales=torch.full((2, 3), -1.2, dtype=torch.float64),
        peaks=torch.tensor([0.5, 1.5], dtype=torch.float64),
        velocities=torch.tensor([[2.0, 1, 0], [-1, 2, 0]], dtype=torch.float64),
        log_spans=torch.tensor([0.0, -0.7], dtype=torch.float64),
        offsets=(draw(2, 2, 3), 0.5 * draw(2, 12, 3)),
    )  # fmt: skip
    networks = mh.create_networks(settings, generator, torch.float64)
    eye = torch.tensor([0.0, -8, 4], dtype=torch.float64)
    times = np.linspace(-1, 3, 60)
    moments = [mh.decode(stored, networks, settings, float(t), eye) for t in times]
    means = torch.stack([m.means for m in moments]).numpy()
    opacities = torch.stack([m.opacities for m in moments]).numpy()
    figure, axes = panels(2, width=12.0, ratio=0.7)
    for i in range(means.shape[1]):
        colour = COLOURS[i // 12]
        axes[0].plot(means[:, i, 0], means[:, i, 1], color=colour, linewidth=0.7)
        axes[1].plot(times, opacities[:, i], color=colour, linewidth=0.7)
    show_plan(axes[0], "paths of 12 Gaussians of each of two anchors, residuals at zero")
    axes[1].set_title("their opacity over time: the anchor's life", fontsize=9)
    axes[1].set_xlabel("time", fontsize=8)
    save(figure, path)


def draw_dense_points(scene: Scene, path: Path) -> None:
    """A pair, its certainty, and the depth of the points that survive.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    views = scene.views
    seen = dense_initialisation.observations(scene.points, len(views))
    settings = dense_initialisation.DenseSettings()
    centres = torch.stack([view.camera.centre for view in views])
    pairs = dense_initialisation.select_pairs(centres, scene.points.positions, seen, settings)
    shared = [dense_initialisation.seen_by_both(seen, *pair) for pair in pairs]
    most = int(np.argmax([len(points) for points in shared]))
    a, b = pairs[most]
    image_a, image_b = views[a].load(), views[b].load()
    both = scene.points.positions[shared[most]]
    plane = plane_between(
        project_points(views[a].camera, both)[0], project_points(views[b].camera, both)[0]
    )
    warp, certainty = match_by_flow(image_a, image_b, plane)
    points = dense_initialisation.points_of_pair(
        views[a].camera, views[b].camera, image_a, warp.double(), certainty, settings
    )
    merged = dense_initialisation.merge_in_voxels(points, _anchors_of(scene, 3000)[1])
    figure, axes = panels(4, width=14.0)
    show_image(axes[0], image_a.numpy(), views[a].name)
    show_image(axes[1], image_b.numpy(), views[b].name)
    show_image(axes[2], certainty.numpy(), "certainty of the flow", cmap="viridis", vmin=0, vmax=1)
    axes[3].scatter(merged.positions[:, 0], merged.positions[:, 1], s=1,
                    c=merged.colours.clamp(0, 1).numpy())  # fmt: skip
    show_plan(axes[3], f"{len(points.scores)} points, merged to {len(merged.scores)}")
    save(figure, path)
