"""What the light of each training view is like, and the factor that adapts colours to it."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.dlg_gs.settings import Factor
from splatproof.reference.anchors import hvi
from splatproof.reference.types.scene import View

STATISTICS, LAYER, EMBEDDING = "light.statistics", "light.layer", "light.embedding"
"""Shared tensors: of each training view's photo (frozen), the layer on them; or what is learnt."""
LEAST_SPREAD = 1e-6
"""Deviation of a statistic below which all views count as alike: what rounding leaves."""


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
        return {EMBEDDING: torch.randn(len(views), width, generator=generator)}
    described = standardised(torch.stack([statistics(view, kind) for view in views]))
    layer = torch.randn(described.shape[1], width, generator=generator)
    return {STATISTICS: described, LAYER: layer * described.shape[1] ** -0.5}


def standardised(described: Float[Tensor, "v 12"]) -> Float[Tensor, "v 12"]:
    """Each statistic with mean 0 and deviation 1 over the training views; 0 where all are alike.

    Photos of one scene have statistics that differ by a few hundredths: as they are, a layer that
    starts small makes nearly the same factor of all of them, and training does not find out.

    Args:
        described: Statistics of each training view.

    Source: ours.
    """
    off = described - described.mean(dim=0)
    spread = off.square().mean(dim=0).sqrt()
    return torch.where(spread > LEAST_SPREAD, off / spread.clamp(min=LEAST_SPREAD), 0)


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
