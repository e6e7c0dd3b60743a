"""Neural multi-plane Gaussians: virtual Gaussians where camera rays meet a stack of planes."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.splats import Splats

BIAS_NEAR, BIAS_FAR = -4.6, 1.4
"""Opacity logits added at a ray's nearest and farthest hit (paper, Sec. 4): 0.01 and 0.80."""
PARALLEL = 1e-6
"""Rays with |n . d| at or below this never meet a plane."""
UNIQUE = 1e-6
"""The smallest singular value must lie below the next by this share of the largest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneStack:
    """K parallel planes n . p + d_k = 0, fixed, shared by all views."""

    normal: Float[Tensor, "3"]
    """n: unit normal of all planes, on the side of up."""
    offsets: Float[Tensor, " k"]
    """d_k of each plane in scene units."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """Where rays meet planes; entries that are not valid hold finite numbers without meaning."""

    positions: Float[Tensor, "r k 3"]
    distances: Float[Tensor, "r k"]
    """t_k: distance of each hit from the ray's origin, scene units."""
    valid: Bool[Tensor, "r k"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Sites:
    """The virtual Gaussians of one view as far as the field has no say in them."""

    positions: Float[Tensor, "n 3"]
    """Where rays meet planes, in the world, scene units: they never move."""
    bias: Float[Tensor, " n"]
    """Logit b(t) that is added to the field's opacity."""
    spacing: Float[Tensor, " n"]
    """Gap between neighbouring rays at that distance, scene units."""


def plane_normal(points: Float[Tensor, "n 3"], up: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    """Direction of least variance of the cloud: last right singular vector of P - mean(P).

    Args:
        points: Dense cloud in scene units.
        up: Any vector on the upper side; it fixes the sign.

    Raises: ValueError if the smallest singular value is not unique (fewer than three points, a
        line, a sphere): the caller then has to choose a direction, usually up itself.

    Source: StratoSplat, Sec. 3.3, "Plane-Based Gaussian Generation".
    """
    centred = points - points.mean(dim=0) if len(points) else points.new_zeros(1, 3)
    _, values, axes = torch.linalg.svd(
        torch.cat([centred, points.new_zeros(3, 3)]), full_matrices=False
    )
    if not values[1] - values[2] > UNIQUE * values[0]:
        raise ValueError(
            f"no unique direction of least variance: singular values {values.tolist()}"
        )
    return axes[2] * (1 if axes[2] @ up.to(axes) >= 0 else -1)


def plane_stack(points: Float[Tensor, "n 3"], normal: Float[Tensor, "3"], count: int) -> PlaneStack:
    """`count` planes at equal distances over the range of n . p; a single one in the middle.

    Args:
        points: Dense cloud in scene units, whose range the planes divide.
        normal: Unit normal n of all planes (plane_normal).
        count: Number of planes K, at least 1.

    Raises: ValueError if there is no point or no plane.

    Source: StratoSplat, Sec. 3.3.
    """
    if count < 1 or not len(points):
        raise ValueError(f"need at least one plane and one point: {count}, {len(points)}")
    heights = points @ normal
    low, high = heights.min(), heights.max()
    steps = torch.linspace(0, 1, count).to(points) if count > 1 else points.new_tensor([0.5])
    return PlaneStack(normal=normal, offsets=-(low + (high - low) * steps))


def pixel_rays(camera: Camera, stride: int) -> Float[Tensor, "r 3"]:
    """Unit world directions through the middle of every stride x stride cell of pixels.

    Args:
        camera: Pinhole camera of the view; rays start at its centre.
        stride: Side of a cell in pixels, at least 1; 1 gives a ray a pixel (the paper).

    Returns: Row-major over the cells whose middle lies in the image.
    """
    if stride / 2 >= min(camera.height, camera.width):
        return camera.K.new_zeros(0, 3)
    rows, columns = torch.meshgrid(
        torch.arange(stride / 2, camera.height, stride),
        torch.arange(stride / 2, camera.width, stride),
        indexing="ij",
    )
    pixels = torch.stack([columns, rows, torch.ones_like(rows)], dim=-1).reshape(-1, 3)
    world = pixels.to(camera.K) @ torch.linalg.inv(camera.K).T @ camera.rotation
    return world / world.norm(dim=1, keepdim=True)


def ray_hits(
    stack: PlaneStack, origin: Float[Tensor, "3"], directions: Float[Tensor, "r 3"], near: float
) -> Hits:
    """Hits t_k = -(n . o + d_k) / (n . d), kept where |n . d| > 1e-6 and t_k > near.

    Args:
        stack: The planes, from `plane_stack`.
        origin: Camera centre in the world, scene units.
        directions: Unit ray directions in the world.
        near: Hits at this distance or nearer are dropped. Scene units.

    Source: StratoSplat, Sec. 3.3.
    """
    slope = directions @ stack.normal
    meets = slope.abs() > PARALLEL
    t = -(origin @ stack.normal + stack.offsets)[None] / torch.where(meets, slope, 1)[:, None]
    valid = meets[:, None] & (t > near)
    t = torch.where(valid, t, 0)
    return Hits(positions=origin + t[..., None] * directions[:, None], distances=t, valid=valid)


def opacity_bias(hits: Hits) -> Float[Tensor, "r k"]:
    """Logit b(t), linear in the ray distance from -4.6 at a ray's nearest hit to 1.4 at its last.

    The paper says "normalized by ray distance"; we normalise over each ray's own hits, so that
    oblique rays start with a clear front too. A ray with a single hit gets the far value.

    Source: StratoSplat, Sec. 3.3 and 4.
    """
    near = torch.where(hits.valid, hits.distances, torch.inf).amin(dim=1, keepdim=True)
    far = torch.where(hits.valid, hits.distances, 0).amax(dim=1, keepdim=True)
    spread = far - near
    several = spread > 0
    share = torch.where(several, (hits.distances - near) / torch.where(several, spread, 1), 1)
    return torch.where(hits.valid, BIAS_NEAR + (BIAS_FAR - BIAS_NEAR) * share, 0)


def sites_of(hits: Hits, camera: Camera, stride: int, *, biased: bool = True) -> Sites:
    """What the virtual Gaussians of a view have before the field is asked: its valid hits.

    Args:
        hits: Where the rays of `pixel_rays` meet the planes.
        camera: The view's camera; its focal length gives the gap between rays.
        stride: Side of a ray's cell in pixels, as `pixel_rays` was given.
        biased: Whether far planes start more opaque than near ones; False: an ablation of the paper.
    """
    distances = hits.distances[hits.valid]
    bias = opacity_bias(hits)[hits.valid] if biased else torch.zeros_like(distances)
    return Sites(
        positions=hits.positions[hits.valid],
        bias=bias,
        spacing=distances * stride / float(camera.K[0, 0]),
    )


def decoded(outputs: Float[Tensor, "n 9"], sites: Sites) -> Splats:
    """Turn the field's nine numbers a site into Gaussians: colour 3, opacity 1, scale 1, rotation 4.

    Opacity is sigmoid(logit + b(t)). A zero scale output is as wide as the gap between rays at
    that distance (ours: the paper leaves the activation open), so the start covers the image.

    Args:
        outputs: Field values at the sites.
        sites: Places, biases and gaps of the view's virtual Gaussians.

    Source: StratoSplat, Sec. 3.3.
    """
    scale = outputs[:, 4].exp() * sites.spacing
    return Splats(
        means=sites.positions,
        quaternions=outputs[:, 5:],
        scales=scale[:, None].expand(-1, 3),
        opacities=torch.sigmoid(outputs[:, 3] + sites.bias),
        colours=torch.sigmoid(outputs[:, :3]),
        rows=torch.full((len(outputs),), -1, device=outputs.device),
    )


def virtual_gaussians(
    outputs: Float[Tensor, "n 9"], hits: Hits, camera: Camera, stride: int
) -> Splats:
    """The virtual Gaussians of a view: `decoded` at its `sites_of`.

    Args:
        outputs: Field values at the n valid hits, in row-major order of (ray, plane).
        hits: Where the rays of `pixel_rays` meet the planes.
        camera: The view's camera.
        stride: Side of a ray's cell in pixels, as `pixel_rays` was given.
    """
    return decoded(outputs, sites_of(hits, camera, stride))


def render_joint(
    camera: Camera,
    explicit: Gaussians,
    virtual: Splats,
    background: Float[Tensor, "3"] | None = None,
) -> RenderOutput:
    """Composite explicit and virtual Gaussians together in one depth order.

    Args:
        camera: Camera of the view for which `virtual` was made.
        explicit: Gaussians with parameters of their own.
        virtual: Gaussians of this view, from `virtual_gaussians`.
        background: sRGB behind everything; None is black.

    Source: StratoSplat, Sec. 3.3, "Joint Training".
    """
    return rasterize(
        camera,
        torch.cat([explicit.means, virtual.means]),
        torch.cat([explicit.quaternions, virtual.quaternions]),
        torch.cat([explicit.scales, virtual.scales]),
        torch.cat([explicit.opacities, virtual.opacities]),
        sh=explicit.sh,
        colours=virtual.colours,
        background=background,
    )
