"""Rising difficulties of depth, dense points, side views, few views, memory, anchors and light."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from splatproof.reference.anchors import control, lighting_appearance, motion_hierarchy
from splatproof.reference.anchors.control import GrowthSettings
from splatproof.reference.anchors.motion_hierarchy import HierarchySettings, MotionAnchors
from splatproof.reference.layered_memory import (
    coordinate_field,
    depth_adaptation,
    guide_depth,
    layered_depth,
)  # fmt: skip
from splatproof.reference.layered_memory.depth_adaptation import AdaptationSettings, SparseDepths
from splatproof.reference.layered_memory.edge_diffusion import EdgeDiffusion
from splatproof.reference.layered_memory.nadir_reference import nadir_reference
from splatproof.reference.sparse_views import (
    co_pruning,
    depth_correlation,
    pseudo_views,
    unpooling,
)  # fmt: skip
from splatproof.reference.supervision import (
    decoupled_appearance,
    dense_initialisation,
    dense_matching,
    depth_supervision,
    side_views,
    sideways_view,
    spiral_path,
)  # fmt: skip
from splatproof.reference.supervision.side_views import SeenView
from splatproof.reference.supervision.spiral_path import SpiralSettings
from splatproof.reference.types import mlp
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.nearest_view import nearest_view
from splatproof.reference.types.scene import camera_view
from splatproof.suites.hard_cases.case import joined
from splatproof.suites.hard_cases.rising import Rising, generator, normal, tenth, uniform

SIDE = 12
"""Pixels on each side of small pictures."""


def camera(x: float = 0.0, *, z: float = 0.0, focal: float = 12.0) -> Camera:
    """A camera that looks along z.

    Args:
        x: Where it stands, scene units.
        z: Where it stands, scene units.
        focal: Focal length in pixels.
    """
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 3], pose[2, 3] = -x, -z
    K = torch.tensor([[focal, 0, SIDE / 2], [0, focal, SIDE / 2], [0, 0, 1]], dtype=torch.float64)
    return Camera(K=K, world_to_camera=pose, width=SIDE, height=SIDE)


def picture(seed: int = 0) -> Tensor:
    """Random pixels in (0, 1)."""
    return 0.05 + 0.9 * uniform(SIDE, SIDE, 3, seed=seed)


def _triangulated(rung: float, first: Tensor, second: Tensor) -> Tensor:
    """Depth in baselines, and the rays' angle in its own size."""
    a, b = camera().to(first.dtype), camera(1.0).to(first.dtype)
    positions, angles = dense_initialisation.triangulate(a, b, first, second)
    return joined(positions / rung, angles * rung)


def _landed(rung: float) -> tuple[Tensor, Tensor]:
    points = rung * (torch.tensor([0.0, 0, 1]).double() + 0.2 * uniform(10, 3))
    (a, _), (b, _) = (project_points(camera(x), points) for x in (0.0, 1.0))
    return a, b


def _flow(rung: float, texture: Tensor) -> Tensor:
    """Certainty where one photo is the other moved by a pixel, of less and less contrast."""
    image = (
        128 / 255 + (texture - 0.5) / rung
    )  # eight bits deep inside: not between two of their steps
    warp, certainty = dense_matching.match_by_flow(image, image.roll(1, dims=1))
    return joined(warp * certainty[..., None], certainty).to(texture)


def _spiral(rung: float, centre: Tensor) -> Tensor:
    """Orbits so flat that cameras look nearly straight down."""
    up = centre.new_tensor([0.0, 0, 1])
    poses = spiral_path.spiral_path(centre, up, 1 / rung, 1.0, SpiralSettings(layers=2, views=3))
    return poses[..., :3, :3]


def _side(rung: float, render: Tensor, refined: Tensor, alpha: Tensor) -> Tensor:
    """A render and its refinement that differ by ever less, behind and before what photos see."""
    depth = torch.full((SIDE, SIDE), 4.0).to(render)
    one, other = (
        SeenView(camera=camera(x), image=render.detach(), alpha=alpha.detach(), depth=depth)
        for x in (0.0, 0.5)
    )
    seen = side_views.seen_by(one, [other, other])
    close = render + (refined - render) / rung
    loss = side_views.side_loss(render, close.detach(), alpha.detach(), seen.to(render))
    return joined(loss * rung, seen)


def _beside(rung: float, image: Tensor, photo: Tensor, uneven: Tensor) -> Tensor:
    """A scene ever further away, seen from beside, and its inverse depth."""
    depth = rung * (1 + uneven)
    every = torch.ones(SIDE, SIDE, dtype=torch.bool)
    beside = sideways_view.sideways(camera(), depth.median())
    loss = sideways_view.sideways_loss(image, beside, photo, camera(), depth, every)
    return joined(
        loss, sideways_view.inverse_depth_loss(depth, 1 / (rung * (1 + photo[..., 0])), every)
    )


def _appearance(rung: float, image: Tensor, photo: Tensor, last: Tensor) -> Tensor:
    """A network of a photo's appearance whose factors are cut off by their sigmoids."""
    network = {
        name: value.to(image)
        for name, value in decoupled_appearance.drawn_network(generator()).items()
    } | {"last.weight": rung * last}
    embedding = torch.ones(decoupled_appearance.EMBEDDING).to(image)
    factors = decoupled_appearance.colour_map(network, image, embedding)
    return joined(decoupled_appearance.decoupled_loss(image, factors, photo), factors)


def _unpooled(rung: float, means: Tensor) -> Tensor:
    """Gaussians `rung` times as near to each other as they are far from the origin."""
    distances, neighbours = unpooling.nearest_others(means)
    made = unpooling.unpooled(means, distances, neighbours, 1.0, most=10)
    del rung
    return joined(distances, made.means, made.destinations)


def _correlated(rung: float, depth: Tensor, disparity: Tensor) -> Tensor:
    """Depth that varies by 1 / rung of itself."""
    valid = torch.ones(SIDE, SIDE, dtype=torch.bool)
    return depth_correlation.correlation_loss(10 + depth / rung, disparity, valid)[None]


def _matched(rung: float, one: Tensor, other: Tensor) -> Tensor:
    del rung
    return co_pruning.matched(one, other, 0.75).to(one)


def _between(rung: float, share: Tensor) -> Tensor:
    """Half way between cameras that look apart by half a turn less 1 / rung."""
    turn = torch.tensor(math.pi - 1 / rung, dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 0] = pose[2, 2] = turn.cos()
    pose[0, 2], pose[2, 0] = turn.sin(), -turn.sin()
    first, second = camera(), replace(camera(1.0), world_to_camera=pose)
    found = pseudo_views.between(first.to(share.dtype), second.to(share.dtype), float(share))
    return found.world_to_camera.to(share)


def _aligned(rung: float, prediction: Tensor, truth: Tensor) -> Tensor:
    """Predictions that vary by 1 / rung: the scale that takes them to the depths, in its own size."""
    rows, columns = (torch.arange(SIDE) for _ in range(2))
    sparse = SparseDepths(rows=rows, columns=columns, depths=truth[rows, columns])
    flat = 0.5 + (prediction - 0.5) / rung
    scale, shift = depth_adaptation.align(flat, sparse)
    return joined(scale * flat + shift)


def _adapted(rung: float, image: Tensor, truth: Tensor) -> Tensor:
    """A view's depth from few points and the guide, of which one point is `rung` times as far."""
    rows = columns = torch.arange(SIDE)
    depths = truth[rows, columns].clone()
    depths[0] *= rung
    sparse = SparseDepths(rows=rows, columns=columns, depths=depths)
    settings = AdaptationSettings(guidance_steps=2)
    found = depth_adaptation.adapt_view(
        EdgeDiffusion(steps=2, sweeps=4), image, sparse, truth, truth > 0, settings, generator()
    )
    return found / rung


def _diffused(rung: float, latent: Tensor, image: Tensor) -> Tensor:
    """Smoothing between edges, ever more of which stop it."""
    smooth = EdgeDiffusion(steps=2, sweeps=8, contrast=1 / rung)
    return smooth.predict_clean(latent, image, 0)


def _guide(rung: float, points: Tensor) -> Tensor:
    """Surfaces of which one lies `rung` times as far as the other."""
    memory = layered_depth.empty(camera(), 0.02)
    memory = layered_depth.insert(memory, points, torch.zeros_like(points))
    depth, visible = guide_depth.render(memory, camera(0.01))
    return joined(depth / rung, visible)


def _plane(rung: float) -> tuple[Tensor, ...]:
    at = (torch.arange(SIDE).double() + 0.5 - SIDE / 2) / 12
    x, y = torch.meshgrid(at, at, indexing="xy")
    z = torch.where(x > 0, 2.0 * rung, 2.0).double()
    return (torch.stack([x * z, y * z, z], dim=-1).reshape(-1, 3),)


def _nadir(rung: float, up: Tensor) -> Tensor:
    """Views whose frusta end `rung` times as far as they begin."""
    cameras = [camera(x).to(up.dtype) for x in (0.0, 1.0)]
    found = nadir_reference(cameras, [(1.0, rung)] * 2, up)
    return joined(found.rotation, found.centre / rung).to(up)


def _field(rung: float, positions: Tensor) -> Tensor:
    """A field far outside its box, where its border's features hold."""
    low, high = positions.new_full((3,), -1.0), positions.new_full((3,), 1.0)
    made = coordinate_field.create(low, high, 3, generator(), resolutions=(2, 4), width=8)
    del rung
    return coordinate_field.evaluate(made, positions)


SIZES = HierarchySettings(gaussians=4, features=4, instance=3)


def _hierarchy(rung: float, centres: Tensor, velocities: Tensor) -> Tensor:
    """Anchors so many periods after the time that they stand at their centres."""
    count = len(centres)

    def like(drawn: Tensor) -> Tensor:
        return drawn.to(centres)

    offsets = tuple(like(normal(count, n, 3, seed=n)) for n in (2, 4))
    anchors = MotionAnchors(
        centres=centres, features=like(normal(count, 4, seed=3)),
        instances=like(normal(count, 3, seed=5)), quaternions=like(normal(count, 4, seed=6)),
        log_scales=like(normal(count, 3, seed=7)), peaks=like(uniform(count, seed=8)),
        velocities=velocities, log_spans=centres.new_full((count,), 20.0), offsets=offsets,
    )  # fmt: skip
    networks = motion_hierarchy.create_networks(SIZES, generator(), centres.dtype)
    splats = motion_hierarchy.decode(
        anchors, networks, SIZES, 0.3 + rung, centres.new_tensor([0.0, 0, -9])
    )
    return joined(splats.means, splats.scales, splats.opacities)


def _grown(rung: float, places: Tensor) -> Tensor:
    """Gaussians in the middle of voxels that lie far away, and the anchors that grow from them."""
    gradients = places.new_full((len(places),), 1.0)
    statistics = control.voxel_statistics(places, gradients, 1.0)
    made = control.new_anchors(places[:2], places, statistics, 1.0, GrowthSettings(density=2.0))
    return joined(statistics.density, made - rung)


def _depth_terms(rung: float, depth: Tensor, image: Tensor, alpha: Tensor) -> Tensor:
    """Smoothness and LiDAR terms of depth so far away, and a sky that is opaque but for 1 / rung."""
    hit = torch.ones(SIDE, SIDE, dtype=torch.bool)
    sky = torch.arange(SIDE)[:, None].expand(SIDE, SIDE) < SIDE // 2
    return torch.stack([
        depth_supervision.smoothness_loss(rung * depth, image.detach(), 10.0) / rung,
        depth_supervision.lidar_loss(rung * depth, rung * depth.detach().flip(0), hit) / rung,
        depth_supervision.sky_loss(1 - alpha / rung, sky) / 20,
        depth_supervision.outlier_loss(depth, image.detach(), 10.0, 0.05),
    ])  # fmt: skip


def _lit(rung: float, colours: Tensor, factor: Tensor, scales: Tensor) -> Tensor:
    """Colour heads whose outputs are cut off by their sigmoids, volumes that underflow."""
    drawn = mlp.create((3 + 4 + 2, 8, 8, 4), generator(), torch.float64)
    head = mlp.change(drawn, lambda tensor: (tensor * rung ** (1 / 3)).to(colours))
    attended = colours[:, :2]
    adapted = lighting_appearance.adapt_colours(head, colours, factor, attended)
    return joined(adapted, lighting_appearance.volume_loss(scales / rung))


def _lights(rung: float, turns: Tensor) -> Tensor:
    """Which of the training views has a view's light, so far from the origin."""
    views = [camera_view(camera(rung + float(x))) for x in turns]
    found = [nearest_view(camera_view(camera(rung + x)), views) for x in (0.2, 1.2, 2.2)]
    return torch.stack([one.camera.centre[0] - rung for one in found]).to(turns)


CASES = (
    Rising(component="dense points", name="depth / baseline", run=_triangulated, inputs=_landed,
           rungs=(1.0, 1e1, 1e2, 1e3), more=tenth,
           reason="a parallax of 12 / h pixels of positions that are rounded to 5e-7 pixels"),
    Rising(component="dense matching", name="times as little contrast", run=_flow,
           rungs=(1.0, 1e1, 1e2, 1e4), inputs=lambda h: (uniform(32, 32, 3),)),
    Rising(component="spiral", name="height / footprint", run=_spiral, inputs=lambda h: (normal(3),),
           rungs=(1.0, 1e1, 1e2, 1e4), more=tenth,
           reason="the image's top stands across a direction that is 1 / h off nadir; places are rounded to 1e-7"),
    Rising(component="side views", name="times as alike", run=_side, rungs=(1.0, 1e1, 1e2, 1e3),
           inputs=lambda h: (picture(), picture(1), 0.5 * uniform(SIDE, SIDE)), more=tenth,
           reason="the loss is shown in the size of what differs, 1 / h; colours are rounded to 6e-8"),
    Rising(component="sideways view", name="times as far", run=_beside, rungs=(1.0, 1e2, 1e4), differentiable=True,
           inputs=lambda h: (picture(), picture(1), 0.2 * uniform(SIDE, SIDE))),
    Rising(component="photo appearance", name="times as steep", run=_appearance, differentiable=True,
           rungs=(1.0, 1e1, 1e2, 1e3), inputs=lambda h: (picture(), picture(1), normal(3, 16, 3, 3)), more=tenth,
           reason="what the sigmoid reads is rounded to 6e-8 of its size, which is h"),
    Rising(component="unpooling", name="distance from the origin", run=_unpooled,
           inputs=lambda h: ((8 * normal(16, 3)).round() + h,)),
    Rising(component="depth correlation", name="depth / its variation", run=_correlated,
           inputs=lambda h: (normal(SIDE, SIDE), normal(SIDE, SIDE) + normal(SIDE, SIDE, seed=1)),
           rungs=(1.0, 1e2, 1e4), more=tenth, differentiable=False,
           reason="depth of 10 is rounded to 1e-6 and varies by 1 / h"),
    Rising(component="co-pruning", name="distance from the origin", run=_matched,
           inputs=lambda h: ((8 * normal(16, 3)).round() + h, (8 * normal(16, 3)).round() + 0.25 + h)),
    Rising(component="pseudo views", name="1 / (half a turn - angle)", run=_between,
           inputs=lambda h: (torch.tensor(0.5).double(),)),
    Rising(component="depth adaptation", name="1 / variation of the prediction", run=_aligned,
           rungs=(1.0, 1e2, 1e4), more=tenth, reason="the prediction 0.5 is rounded to 6e-8 and varies by 1 / h",
           inputs=lambda h: (uniform(SIDE, SIDE), 2 + 2 * uniform(SIDE, SIDE) + uniform(SIDE, SIDE, seed=1))),
    Rising(component="depth adaptation", name="times as far, one point", run=_adapted,
           inputs=lambda h: (picture(), 2 + uniform(SIDE, SIDE))),
    Rising(component="edge diffusion", name="1 / contrast of an edge", run=_diffused,
           inputs=lambda h: (normal(SIDE, SIDE), picture())),
    Rising(component="guide depth", name="far / near", run=_guide, inputs=_plane),
    Rising(component="nadir reference", name="far / near", run=_nadir, rungs=(1.0, 1e2, 1e4, 1e6),
           inputs=lambda h: (torch.tensor([0.0, 0, 1]).double(),)),
    Rising(component="coordinate field", name="distance / box", run=_field,
           inputs=lambda h: (h * normal(20, 3),)),
    Rising(component="motion hierarchy", name="periods away", run=_hierarchy, rungs=(1.0, 1e1, 1e2, 1e3),
           inputs=lambda h: (normal(4, 3), normal(4, 3, seed=1)), more=tenth,
           reason="the phase 2 pi t is rounded to 6e-8 of itself"),
    Rising(component="anchor control", name="distance from the origin", run=_grown,
           inputs=lambda h: ((4 * uniform(30, 3)).floor() + 0.5 + h,)),
    Rising(component="depth supervision", name="times as far", run=_depth_terms, differentiable=True,
           rungs=(1.0, 1e1, 1e2, 1e3),
           inputs=lambda h: (1 + uniform(SIDE, SIDE), picture(), 0.1 + 0.8 * uniform(SIDE, SIDE, seed=2))),
    Rising(component="lighting", name="times as steep", run=_lit, differentiable=True, rungs=(1.0, 1e1, 1e2, 1e3),
           inputs=lambda h: (uniform(9, 3), normal(4), 0.1 + uniform(9, 3, seed=1))),
    Rising(component="nearest view", name="distance from the origin", run=_lights,
           inputs=lambda h: (torch.arange(3.0).double(),)),
)  # fmt: skip
