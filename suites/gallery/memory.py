"""Pictures of the layered memory, the depth it guides, and the planes beside it."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.layered_memory import (
    coordinate_field,
    depth_adaptation,
    guide_depth,
    layered_depth,
    multi_plane,
)
from splatproof.reference.layered_memory.edge_diffusion import EdgeDiffusion
from splatproof.reference.layered_memory.layered_depth import LayeredDepth
from splatproof.reference.supervision import side_views
from splatproof.reference.supervision.spiral_path import SpiralSettings, spiral_path
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.gallery.drawing import COLOURS, panels, save, show_image, show_plan


def _truth(view: View) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """World points and colours of a view's exact depth."""
    assert view.load_depth is not None, f"{view.name} has no true depth"
    depth = view.load_depth()
    hit = depth.isfinite().reshape(-1)
    points = side_views.unproject(view.camera, torch.where(depth.isfinite(), depth, 0))
    return points[hit], view.load().reshape(-1, 3)[hit]


def _most_downward(scene: Scene) -> int:
    """The view that looks down most steeply: the reference camera."""
    forward = torch.stack([view.camera.rotation[2] for view in scene.views])
    return int((forward @ scene.up).argmin())


def filled_memory(scene: Scene, count: int = 8) -> LayeredDepth:
    """The true depths of some views in one memory; eps_d is 1 % of the reference's mean depth.

    Args:
        scene: Scene whose views have true depth.
        count: Views that are put in, at most.
    """
    first = _most_downward(scene)
    points, _ = _truth(scene.views[first])
    camera = scene.views[first].camera
    depth = (points - camera.centre) @ camera.rotation[2]
    memory = layered_depth.empty(camera, float(0.01 * depth.mean()))
    for view in scene.views[:: max(1, len(scene.views) // count)]:
        memory = layered_depth.insert(memory, *_truth(view))
    return memory


def draw_layers(scene: Scene, path: Path) -> None:
    """Layers a pixel, the nearest layer, and the guide depth in another view.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    memory = filled_memory(scene)
    camera = memory.camera
    shape = (camera.height, camera.width)
    held = torch.bincount(memory.pixels, minlength=shape[0] * shape[1]).reshape(shape)
    first = torch.ones(len(memory), dtype=torch.bool)
    first[1:] = memory.pixels[1:] != memory.pixels[:-1]
    nearest = torch.full((shape[0] * shape[1],), torch.nan, dtype=torch.float64)
    nearest[memory.pixels[first]] = memory.depths[first]
    other = scene.views[0]
    guide, seen = guide_depth.render(memory, other.camera)
    figure, axes = panels(4, width=13.0)
    show_image(axes[0], scene.views[_most_downward(scene)].load().numpy(), "reference view")
    show_image(axes[1], held.numpy(), f"layers a pixel (most {int(held.max())})", cmap="viridis")
    show_image(axes[2], nearest.reshape(shape).numpy(), "depth of the nearest layer", cmap="magma")
    guide = torch.where(seen, guide, torch.nan)
    show_image(axes[3], guide.numpy(), f"guide depth in {other.name}", cmap="magma")
    save(figure, path)


def draw_adaptation(scene: Scene, path: Path) -> None:
    """A view's depth from a few points: aligned, guided, and the truth.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    index = scene.train[0]
    view = scene.views[index]
    assert view.load_depth is not None
    image = view.load().double()
    seen = _tracks_of(scene, index)
    sparse = depth_adaptation.sparse_depths(view.camera, scene.points.positions[seen])
    nothing = torch.zeros(image.shape[:2], dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    adapted = depth_adaptation.adapt_view(
        EdgeDiffusion(), image, sparse, nothing, nothing.bool(),
        depth_adaptation.AdaptationSettings(), generator,
    )  # fmt: skip
    truth = view.load_depth().double()
    error = (adapted - truth).abs() / truth
    limits = {"vmin": float(truth.quantile(0.02)), "vmax": float(truth.quantile(0.98))}
    figure, axes = panels(4, width=13.0)
    show_image(axes[0], image.numpy(), f"{len(sparse.depths)} sparse points")
    axes[0].scatter(sparse.columns, sparse.rows, s=1, c=COLOURS[1])
    show_image(axes[1], adapted.numpy(), "adapted depth", cmap="magma", **limits)
    show_image(axes[2], truth.numpy(), "true depth", cmap="magma", **limits)
    show_image(axes[3], error.numpy(), f"relative error, median {float(error.median()):.3f}",
               cmap="inferno", vmin=0, vmax=0.1)  # fmt: skip
    save(figure, path)


def _tracks_of(scene: Scene, view: int) -> Tensor:
    """Indices of the points that a view's track holds."""
    points = torch.repeat_interleave(
        torch.arange(len(scene.points)), scene.points.track_starts.diff()
    )
    return points[scene.points.track_views == view]


def draw_planes(scene: Scene, path: Path) -> None:
    """The plane stack in a side view, and where the rays of one camera meet it.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    memory = filled_memory(scene)
    cloud, colours = memory.positions, memory.colours
    normal = multi_plane.plane_normal(cloud, scene.up)
    stack = multi_plane.plane_stack(cloud, normal, 6)
    camera = scene.views[0].camera
    rays = multi_plane.pixel_rays(camera, 24)
    hits = multi_plane.ray_hits(stack, camera.centre, rays, camera.near)
    low, high = cloud.amin(dim=0) - 1, cloud.amax(dim=0) + 1
    field = coordinate_field.create(low, high, 9, torch.Generator().manual_seed(0))
    outputs = coordinate_field.evaluate(field, hits.positions[hits.valid])
    virtual = multi_plane.virtual_gaussians(outputs, hits, camera, 24)
    side = torch.linalg.cross(normal, torch.eye(3).to(normal)[normal.abs().argmin()])
    figure, axes = panels(2, width=12.0, ratio=0.6)
    shown = cloud[::7]
    axes[0].scatter(shown @ side, shown @ normal, s=0.3, c=colours[::7].numpy())
    for offset in stack.offsets.tolist():
        axes[0].axhline(-offset, color=COLOURS[0], linewidth=0.7)
    axes[0].set_title("true surface from the side, six planes", fontsize=9)
    spread = virtual.means.numpy()
    dots = axes[1].scatter(
        spread @ side.numpy(), spread @ normal.numpy(), c=virtual.opacities.numpy(), s=6,
        cmap="viridis", vmin=0, vmax=1,
    )  # fmt: skip
    eye = camera.centre
    axes[1].plot([float(eye @ side)], [float(eye @ normal)], "k^")
    axes[1].set_title("virtual Gaussians of one camera, coloured by opacity", fontsize=9)
    figure.colorbar(dots, ax=axes[1])
    save(figure, path)


def draw_spiral(scene: Scene, path: Path) -> None:
    """The descent around the scene, from above and from the side.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    cloud = scene.points.positions
    heights = cloud @ scene.up
    ground = float(heights.quantile(0.05))
    middle = cloud.median(dim=0).values
    centre = middle + (ground - middle @ scene.up) * scene.up
    footprint = float((cloud - centre).norm(dim=1).quantile(0.9))
    eyes = torch.stack([view.camera.centre for view in scene.views])
    flight = float((eyes @ scene.up).median()) - ground
    poses = spiral_path(centre, scene.up, footprint, flight, SpiralSettings())
    turned = poses.reshape(-1, 4, 4)
    path_eyes = torch.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in turned]).numpy()
    forward = turned[:, 2, :3].numpy()
    tint = np.repeat(np.arange(poses.shape[0]), poses.shape[1])
    figure, axes = panels(2, width=12.0, ratio=0.8)
    shown = scene.points.colours.numpy() / 255
    for axis, (i, j, name) in zip(axes, ((0, 1, "from above"), (0, 2, "from the side")),
                                  strict=True):  # fmt: skip
        axis.scatter(cloud[:, i], cloud[:, j], s=1, c=shown)
        axis.plot(eyes[:, i], eyes[:, j], "k^", markersize=3, label="training views")
        axis.quiver(path_eyes[:, i], path_eyes[:, j], forward[:, i], forward[:, j],
                    color=[COLOURS[t] for t in tint], width=0.003)  # fmt: skip
        show_plan(axis, f"spiral {name}, one colour an orbit")
    axes[0].legend(fontsize=7)
    save(figure, path)
