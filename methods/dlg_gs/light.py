"""What the light of each training view is like, and the factor that adapts colours to it."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.methods.dlg_gs.settings import Factor
from splatproof.reference.anchors import hvi
from splatproof.reference.types.scene import View

STATISTICS, LAYER, EMBEDDING = "light.statistics", "light.layer", "light.embedding"
"""Shared tensors: of each training view's photo (frozen), the layer on them; or what is learnt."""


def drawn_light(
    views: Sequence[View], kind: Factor, width: int, generator: torch.Generator
) -> dict[str, Tensor]:
    """The tensors that factors are made of, at their start.

    Args:
        views: Training views; all their images are read, unless factors are learnt.
        kind: What tells a view's light.
        width: Numbers of a factor.
        generator: Source of the learnt layer, or of the embeddings.
    """
    if kind == "learnt":
        return {EMBEDDING: torch.randn(len(views), width, generator=generator) * 0.1}
    described = torch.stack([statistics(view, kind) for view in views])
    layer = torch.randn(described.shape[1], width, generator=generator)
    return {STATISTICS: described, LAYER: layer * described.shape[1] ** -0.5}


def statistics(view: View, kind: Factor) -> Float[Tensor, "12"]:
    """What a training view's photo says of its light; masked pixels say nothing.

    Args:
        view: With its image.
        kind: "hvi" or "rgb": the space that the statistics are taken in.
    """
    pixels = view.load().reshape(-1, 3)
    if view.load_mask is not None:
        mask = view.load_mask().reshape(-1)
        pixels = pixels[mask] if mask.any() else pixels.new_zeros(1, 3)
    return hvi.descriptor(pixels) if kind == "hvi" else hvi.statistics(pixels)


def factors(tensors: Mapping[str, Tensor]) -> Float[Tensor, "v e"]:
    """eps_s of each training view: tanh of the layer on its statistics, or of its embedding.

    Args:
        tensors: Those that `drawn_light` named.

    Source: DLG-GS, Eq. 7; embeddings: the row that the paper compares with.
    """
    if EMBEDDING in tensors:
        return torch.tanh(tensors[EMBEDDING])
    return torch.tanh(tensors[STATISTICS] @ tensors[LAYER])


def factor_of(
    view: View, names: Sequence[str], tensors: Mapping[str, Tensor]
) -> Float[Tensor, " e"]:
    """eps_s that a view is shown in.

    Its appearance, where it is a code; that of the training view which its appearance names; without
    an appearance its own, if it was trained on, and else the neutral one: the mean of all.

    Args:
        view: Its name and appearance count.
        names: Names of the training views, in the order of the tensors' rows.
        tensors: Those that `drawn_light` named.

    Raises: UsageError for an appearance that is no training view's name, or a code of another width.
    """
    known, asked = factors(tensors), view.appearance
    if isinstance(asked, Tensor):
        if asked.shape != known.shape[1:]:
            raise UsageError(
                f"view {view.name}: its appearance has shape {tuple(asked.shape)}, expected a code "
                f"of {known.shape[1]} numbers, as fit_appearance gives it"
            )
        return asked.to(known)
    name = view.name if asked is None else asked
    if name in names:
        return known[names.index(name)]
    if asked is not None:
        raise UsageError(
            f"view {view.name}: its appearance is {asked!r}, expected the name of a training view, "
            f"such as {names[0]!r}"
        )
    return known.mean(dim=0)
