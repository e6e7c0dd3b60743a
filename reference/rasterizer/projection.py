"""EWA projection: the 2D Gaussian that a 3D Gaussian leaves on the image."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.reference.types.camera import Camera, transform_points

BLUR = 0.3
"""Low-pass variance added to both image axes, in squared pixels."""
FIELD_MARGIN = 1.3
"""Inside the Jacobian directions are clamped to this many half-field tangents about the middle of the image."""
ALPHA_MIN = 1 / 255
"""Contributions below this are dropped, so a Gaussian's support is an exact ellipse."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Projected:
    """2D Gaussians in pixels. Rows that are not in front mean nothing, but they are finite."""

    means: Float[Tensor, "n 2"]
    """Pixel positions (x, y)."""
    depths: Float[Tensor, " n"]
    """Camera-space z in scene units; the drawing order."""
    covariances: Float[Tensor, "n 2 2"]
    """2D covariances in squared pixels, low-pass included."""
    conics: Float[Tensor, "n 2 2"]
    """Their inverses."""
    compensation: Float[Tensor, " n"]
    """Factor in [0, 1] that mode "antialiased" puts on opacity."""
    in_front: Bool[Tensor, " n"]
    """Whether camera-space z > near; only these Gaussians are drawn."""


def jacobian(camera: Camera, cam: Float[Tensor, "n 3"]) -> Float[Tensor, "n 2 3"]:
    """Derivative of the pixel position by the camera-space position, direction clamped.

    x/z and y/z are clamped to 1.3 times the half-field tangent about the middle of the image, here only: far outside the
    image the linearisation would blow up. The clamped coordinate passes no gradient. The release clamps about the axis;
    where the principal point is beside the middle, as in cropped photos, that would bend Gaussians that are seen (ours).

    Args:
        camera: The pinhole camera; its image size and principal point set the clamp.
        cam: Camera-space means in scene units, z > 0.

    Returns: Pixels per scene unit; rows d x_pixel and d y_pixel, columns x, y, z of camera space.

    Source: Zwicker et al. 2002, "EWA Splatting", Eq. 29; clamp of the 3DGS release.
    """
    fx, fy = camera.K[0, 0].to(cam), camera.K[1, 1].to(cam)
    z = cam[:, 2]
    u = (cam[:, 0] / z).clamp(*_field(camera.width, float(fx), float(camera.K[0, 2])))
    v = (cam[:, 1] / z).clamp(*_field(camera.height, float(fy), float(camera.K[1, 2])))
    zero = torch.zeros_like(z)
    return torch.stack(
        [torch.stack([fx / z, zero, -fx * u / z], dim=1),
         torch.stack([zero, fy / z, -fy * v / z], dim=1)], dim=1)  # fmt: skip


def _field(size: int, focal: float, centre: float) -> tuple[float, float]:
    """Tangents of the two edges of the widened image along one axis."""
    reach, middle = FIELD_MARGIN * 0.5 * size / focal, (0.5 * size - centre) / focal
    return middle - reach, middle + reach


def project(
    camera: Camera, means: Float[Tensor, "n 3"], halves: Float[Tensor, "n 3 3"]
) -> Projected:
    """Project Gaussians: Sigma2 = (J W Sigma W^T J^T)[:2, :2] + 0.3 I.

    Sigma comes as its factor H, Sigma = H H^T, because det(M M^T) = |m1 x m2|^2 with the rows
    m1, m2 of M = J W H keeps all digits for a needle, where the textbook determinant of the
    product loses them, and with them its inverse: from 1e8 on, in float64, half of all needles
    would be seen as hyperbolas.

    Args:
        camera: The pinhole camera; its near plane decides what is in front.
        means: World positions in scene units.
        halves: H = R diag(s) of each Gaussian, from `rotation.half_covariance`, in scene units.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Eq. 5; compensation: Yu et al. 2024,
        "Mip-Splatting", Eq. 9, with the determinants' ratio.
    """
    cam = transform_points(camera, means)
    in_front = cam[:, 2] > camera.near
    # Rows that are not drawn are moved to z = 1, so that no infinity enters their gradients.
    cam = torch.where(in_front[:, None], cam, cam.new_tensor([0.0, 0.0, 1.0]))
    flat = jacobian(camera, cam) @ camera.rotation.to(cam) @ halves
    sharp = flat @ flat.mT
    area = torch.linalg.cross(flat[:, 0], flat[:, 1]).square().sum(dim=1)  # det(sharp)
    blurred_area = area + BLUR * (sharp[:, 0, 0] + sharp[:, 1, 1]) + BLUR**2
    covariances = sharp + BLUR * torch.eye(2).to(sharp)
    a, b, _, c = covariances.flatten(1).unbind(dim=1)
    adjugate = torch.stack([c, -b, -b, a], dim=1).reshape(-1, 2, 2)
    share = area / blurred_area
    positive = share > 0
    compensation = torch.where(positive, torch.where(positive, share, 1).sqrt(), 0)
    return Projected(
        means=(cam @ camera.K.to(cam).T)[:, :2] / cam[:, 2:],
        depths=cam[:, 2],
        covariances=covariances,
        conics=adjugate / blurred_area[:, None, None],
        compensation=compensation,
        in_front=in_front,
    )


def support_box(projected: Projected, opacities: Float[Tensor, " n"]) -> Float[Tensor, "n 2"]:
    """Half-extents (x, y) in pixels of the ellipse d^T Sigma2^-1 d <= 2 ln(255 o); 0 where empty.

    Outside this ellipse alpha < 1/255, so culling by it loses nothing.

    Args:
        projected: The 2D Gaussians, from `project`.
        opacities: Opacity o of each Gaussian in [0, 1], compensation included; at or below 1/255:
            empty.

    Source: ours (spec: conventions, item 3).
    """
    reach = 2 * torch.log(opacities.clamp(min=ALPHA_MIN) / ALPHA_MIN)
    return (reach[:, None] * projected.covariances.diagonal(dim1=1, dim2=2)).sqrt()


def screen_radii(
    camera: Camera, projected: Projected, opacities: Float[Tensor, " n"]
) -> Float[Tensor, " n"]:
    """Longer half-extent of the support's box in pixels; 0 for a Gaussian that cannot be seen.

    Seen means: in front of the near plane, opacity above 1/255 and a box that meets the image.

    Args:
        camera: The camera that they were projected with; its image size decides what meets the
            image.
        projected: The 2D Gaussians, from `project`.
        opacities: Opacity of each Gaussian in [0, 1], compensation included.

    Source: ours; takes the place of the release's 3-sigma radius.
    """
    half = support_box(projected, opacities)
    size = half.new_tensor([camera.width, camera.height])
    meets = ((projected.means + half > 0) & (projected.means - half < size)).all(dim=1)
    seen = projected.in_front & meets & (opacities > ALPHA_MIN)
    return torch.where(seen, half.amax(dim=1), 0)
