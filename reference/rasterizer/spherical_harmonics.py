"""Real spherical harmonics up to degree 3: view-dependent colour."""

import torch
from jaxtyping import Float
from torch import Tensor

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792,
      0.5462742152960396)  # fmt: skip
C3 = (-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
      -0.4570457994644658, 1.445305721320277, -0.5900435899266435)  # fmt: skip


def basis(directions: Float[Tensor, "n 3"], degree: int) -> Float[Tensor, "n k"]:
    """Values of the k = (degree + 1)^2 basis functions, DC first.

    Signs and order are those of the 3DGS release and its .ply files.

    Args:
        directions: Unit vectors along which the functions are evaluated.
        degree: Highest degree of the basis, 0 to 3.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 4; constants from its release.
    """
    x, y, z = directions.unbind(dim=1)
    xx, yy, zz = x * x, y * y, z * z
    values = [torch.full_like(x, C0)]
    if degree >= 1:
        values += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        values += [C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * zz - xx - yy), C2[3] * x * z,
                   C2[4] * (xx - yy)]  # fmt: skip
    if degree >= 3:
        values += [C3[0] * y * (3 * xx - yy), C3[1] * x * y * z, C3[2] * y * (4 * zz - xx - yy),
                   C3[3] * z * (2 * zz - 3 * xx - 3 * yy), C3[4] * x * (4 * zz - xx - yy),
                   C3[5] * z * (xx - yy), C3[6] * x * (xx - 3 * yy)]  # fmt: skip
    return torch.stack(values, dim=1)


def directions_to(means: Float[Tensor, "n 3"], centre: Float[Tensor, "3"]) -> Float[Tensor, "n 3"]:
    """Unit vectors from the camera centre to the means; zero, with zero gradient, where they meet.

    Args:
        means: World positions of the Gaussians in scene units.
        centre: Camera centre in the world, scene units.
    """
    offset = means - centre.to(means)
    zero = (offset == 0).all(dim=1, keepdim=True)
    return torch.where(zero, 0, offset / torch.where(zero, 1, offset).norm(dim=1, keepdim=True))


def colour(sh: Float[Tensor, "n k 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Colour seen along a direction: max(0, SH(direction) + 0.5); gradient zero where clamped.

    Args:
        sh: Coefficients, k in {1, 4, 9, 16}.
        directions: Unit vectors from the camera centre to the Gaussian.

    Returns: sRGB radiance >= 0, without an upper bound.
    """
    degree = {1: 0, 4: 1, 9: 2, 16: 3}[sh.shape[1]]
    raw = torch.einsum("nk,nkc->nc", basis(directions, degree), sh) + 0.5
    return torch.where(raw > 0, raw, 0)


def seen_colours(
    means: Float[Tensor, "n 3"],
    centre: Float[Tensor, "3"],
    sh: Float[Tensor, "m k 3"] | None,
    colours: Float[Tensor, "u c"] | None,
) -> Float[Tensor, "n c"]:
    """Colours that a camera sees: of the first Gaussians by their harmonics, of the others as given.

    Args:
        means: World positions of the Gaussians in scene units.
        centre: Camera centre in the world, scene units.
        sh: Coefficients of the first m Gaussians, k in {1, 4, 9, 16}; None: of none.
        colours: Colours of the other u = n - m; None: of none.

    Raises: ValueError if neither is given, or m + u is not n.
    """
    if sh is None and colours is None:
        raise ValueError("give colours, sh or both")
    given = [len(values) for values in (sh, colours) if values is not None]
    if sum(given) != len(means):
        raise ValueError(f"{len(means)} Gaussians, but {given} harmonics and colours")
    parts = [] if colours is None else [colours]
    if sh is not None:
        parts.insert(0, colour(sh, directions_to(means[: len(sh)], centre)))
    return parts[0] if len(parts) == 1 else torch.cat(parts)
