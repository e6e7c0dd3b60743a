"""What sparse points are to a block: its own, context that explains its views, or ghosts."""

from typing import Literal

import torch
from jaxtyping import Bool, Float64, Int8, Int64
from torch import Tensor

from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.density_control import RowRules
from splatproof.reference.partition.ghosts import block_boxes, ghosts
from splatproof.reference.partition.visibility import track_lengths
from splatproof.reference.types.scene import SparsePoints

OWN, CONTEXT, GHOST = 0, 1, 2
"""Trained and densified; trained, not densified; rendered only. What has no role is left out."""
LEFT_OUT = -1
ROLE = "role"
"""Label of a block's rows that says which of these they are."""
Auxiliary = Literal["none", "context", "ghosts", "both"]
"""none: own points only; context: and all that the block's views see, trained, not densified
(BlockGaussian); ghosts: and what lies in the auxiliary box, of unchanging structure (DPGS); both:
context, and as ghosts what else lies in the auxiliary box."""
Surrounding = Literal["box", "region"]
"""Where ghosts are taken from. box: the bounds of what a block owns, a fifth longer (DPGS, Eq. 7);
of a ragged block that is most of the scene. region: within a normalised distance of 1.2, which is
that same box where the block is one."""


def roles_of(
    points: SparsePoints,
    own: Bool[Tensor, " n"],
    views: Bool[Tensor, " v"],
    labels: Int64[Tensor, " n"],
    block: int,
    upright: Float64[Tensor, "n 3"],
    auxiliary: Auxiliary,
    near: Bool[Tensor, " n"] | None = None,
) -> Int8[Tensor, " n"]:
    """Role of each sparse point in one block; LEFT_OUT for those it does not start from.

    Args:
        points: All points of the scene.
        own: Points that the block trains and densifies.
        views: Views that it trains on, among all of the scene.
        labels: Block that owns each point.
        block: Number of the block.
        upright: Positions in the ground frame, whose axes the auxiliary box follows.
        auxiliary: What takes part beside the block's own points.
        near: Points that may become ghosts; None: those in the auxiliary box around what the block
            owns.

    Source: BlockGaussian, Sec. 3.2 (auxiliary points) and its release; DPGS, Sec. 3.3, Eq. 7
        (ghosts).
    """
    nowhere = torch.zeros(len(points), dtype=torch.bool)
    if auxiliary not in ("ghosts", "both") or not bool((labels == block).any()):
        near = nowhere
    elif near is None:
        _, around = block_boxes(upright, labels, block)
        near = ghosts(upright, labels, block, around)
    seen = seen_points(points, views) if auxiliary in ("context", "both") else nowhere
    return assigned(own, seen, near & (labels != block), auxiliary)


def assigned(
    own: Bool[Tensor, " n"],
    seen: Bool[Tensor, " n"],
    near: Bool[Tensor, " n"],
    auxiliary: Auxiliary,
) -> Int8[Tensor, " n"]:
    """Roles by what holds of each row; of several roles a row has the one that is trained most.

    Args:
        own: What the block trains and densifies.
        seen: What its views see.
        near: What may become ghosts.
        auxiliary: What takes part beside what is its own.

    Returns: OWN, else CONTEXT, else GHOST, else LEFT_OUT.
    """
    roles = torch.full((len(own),), LEFT_OUT, dtype=torch.int8)
    if auxiliary in ("ghosts", "both"):
        roles[near] = GHOST
    if auxiliary in ("context", "both"):
        roles[seen] = CONTEXT
    roles[own] = OWN
    return roles


def seen_points(points: SparsePoints, views: Bool[Tensor, " v"]) -> Bool[Tensor, " n"]:
    """Points that at least one of the views sees.

    Args:
        points: All points of the scene, with their tracks.
        views: Which of all views of the scene look.
    """
    owner = torch.repeat_interleave(torch.arange(len(points)), track_lengths(points))
    seen = torch.zeros(len(points), dtype=torch.bool)
    seen[owner[views[points.track_views.long()]]] = True
    return seen


def role_rules(*, follow: bool) -> RowRules:
    """What density control may do to a block's rows: own ones grow, context is only pruned.

    Args:
        follow: Whether the opacity of ghosts is trained, and then reset too.
    """
    return RowRules(
        growing=lambda parameters: parameters.labels[ROLE] == OWN,
        fixed=lambda parameters: parameters.labels[ROLE] == GHOST,
        steady=lambda parameters: (parameters.labels[ROLE] == GHOST) & (not follow),
    )


def held_rows(parameters: Parameters, *, follow: bool) -> dict[str, Int64[Tensor, " g"]]:
    """Rows of ghosts, by the tensors that keep their values there.

    Args:
        parameters: The tensors of a block, with label ROLE.
        follow: Whether opacity and colour of ghosts are trained (dual mode); geometry never is.
    """
    ghosts = (parameters.labels[ROLE] == GHOST).nonzero()[:, 0]
    still = ("means", "log_scales", "quaternions")
    if not follow:
        still += ("opacity_logits", "sh_dc", "sh_rest")
    return dict.fromkeys(still, ghosts)
