"""Where the pixels of a photo lie in another, as the depth priors of both say it: what a perfect matcher would find."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from splatproof.base.errors import UsageError
from splatproof.methods.priors.alignment import in_scale
from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, View

AGREE = 0.02
"""Share of itself by which a depth may differ from the other photo's before its certainty falls to exp(-1/2)."""


def require_priors(scene: Scene) -> None:
    """Refuse a scene with a training view whose depth nothing says.

    Raises: UsageError that names the view.
    """
    for view in scene.train_views:
        if view.load_prior is None:
            raise UsageError(
                f"scene {scene.name}: training view {view.name} has no depth prior, and setting "
                "dense.matcher is 'prior'; give priors with --depth-prior, or match photos: "
                "--dense.matcher flow"
            )


def match_by_prior(
    first: View, second: View, shared: Float[Tensor, "n 3"]
) -> tuple[Float[Tensor, "h w 2"], Float[Tensor, "h w"]]:
    """Warp W with u_B = u_A + W(u_A) in pixels, and certainty in [0, 1].

    Both priors are brought to the scene's scale by the shared points. A pixel of A goes where its point projects
    in B; it is as sure as B's prior agrees with its depth there: exp(-e^2 / 2), e the difference over 2 % of the
    depth. It is 0 where either prior says nothing or that there is no surface, behind B and beside its image.

    Args:
        first: Photo A, with a depth prior.
        second: Photo B, with a depth prior.
        shared: Sparse points that both see.

    Source: ours. With the true depth as prior it bounds what any matcher can give DPGS's dense initialisation.
    """
    assert first.load_prior is not None
    assert second.load_prior is not None
    here = in_scale(first.load_prior(), first.camera, shared)
    there = in_scale(second.load_prior(), second.camera, shared)
    solid = here.valid & (here.disparity > 0)
    depth = 1 / torch.where(solid, here.disparity, 1).double()
    at, z = project_points(second.camera, unproject(first.camera, depth))
    size = at.new_tensor([second.camera.width, second.camera.height])
    inside = (at >= 0).all(dim=1) & (at < size).all(dim=1)
    known = torch.where(there.valid, there.disparity, 0).double()
    other = functional.grid_sample(
        known[None, None], (2 * at / size - 1)[None, :, None], padding_mode="border",
        align_corners=False,
    )[0, 0, :, 0]  # fmt: skip
    # what lies behind B, or where B knows nothing, is off by 1 at least
    off = (z * other - 1) / AGREE
    sure = torch.exp(-off.square() / 2) * inside
    row, column = torch.meshgrid(
        torch.arange(first.camera.height), torch.arange(first.camera.width), indexing="ij"
    )
    warp = at.reshape(*solid.shape, 2) - (torch.stack([column, row], dim=-1) + 0.5)
    return warp.float(), (sure.reshape(solid.shape) * solid).float()
