"""Local self-attention over lists of neighbours, by the kernels or in torch: twins of the masked dense one."""

import math
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from splatproof.methods.dlg_gs.neighbours import Neighbours
from splatproof.methods.kernels import attention as native
from splatproof.reference.anchors.attention import AttentionWeights


def attention_among(
    query: Float[Tensor, "v dk"],
    key: Float[Tensor, "v dk"],
    value: Float[Tensor, "v dv"],
    seen: Int[Tensor, " v"],
    every: Neighbours,
    centres: Float[Tensor, "n 3"],
    radius: float,
) -> Float[Tensor, "v dv"]:
    """Softmax(Q K^T / sqrt(d_k)) V of some anchors over those of them that are near.

    Args:
        query: A row for each anchor that takes part, as the next two; over sqrt(d_k) already.
        key: What the query is compared with.
        value: What is mixed.
        seen: Which anchors these are, ascending.
        every: Lists of all anchors; they may reach farther than the radius.
        centres: Where all anchors stand.
        radius: How far an anchor sees others, in the unit of the centres; inf: as far as its list reaches.

    Source: DLG-GS, Eqs. 9 to 11.
    """
    if native.applies(query, centres):
        looked = None if radius == math.inf else centres
        return native.attend(
            every.native, seen, query, key, value, centres=looked, radius=radius, scaled=True
        )  # fmt: skip
    near = every.among(seen)
    if radius < math.inf:
        near = near.within(centres[seen], radius)
    return _Attend.apply(query, key, value, near)


def local_attention(
    features: Float[Tensor, "n d"], neighbours: Neighbours, weights: AttentionWeights
) -> Float[Tensor, "n dv"]:
    """Softmax(Q K^T / sqrt(d_k)) V over each anchor's neighbours.

    Twin of splatproof.reference.anchors.attention.local_attention: it differs by rounding only.

    Args:
        features: Gated inputs, from `pooled_gates`.
        neighbours: Which anchors each one sees; itself among them.
        weights: The three projections are read.

    Source: DLG-GS, Eqs. 9 to 11; the backward pass by lists: ours.
    """
    query, key, value = (features @ w for w in (weights.query, weights.key, weights.value))
    return _Attend.apply(query / math.sqrt(key.shape[1]), key, value, neighbours)


class _Attend(torch.autograd.Function):
    """A graph of the pairs would keep three tensors of all pairs; this keeps one number a pair."""

    @staticmethod
    def forward(ctx: Any, query: Tensor, key: Tensor, value: Tensor, neighbours: Neighbours):
        scores = _products(query, key, neighbours)
        sources = neighbours.sources
        highest = scores.new_full((len(query),), -torch.inf)
        highest = highest.scatter_reduce(0, sources, scores, "amax")
        shares = (scores - highest[sources]).exp_()
        shares /= _sums(shares, neighbours)[sources]
        ctx.save_for_backward(query, key, value, shares)
        ctx.neighbours = neighbours
        return _mixed(value, shares, neighbours)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        query, key, value, shares = ctx.saved_tensors
        neighbours, given = ctx.neighbours, grad_outputs[0].contiguous()
        by_share = _products(given, value, neighbours)
        mean = _sums(shares * by_share, neighbours)
        by_score = shares * (by_share - mean[neighbours.sources])
        reverse = neighbours.reverse
        return (
            _mixed(key, by_score, neighbours),
            _mixed(query, by_score[reverse], neighbours),
            _mixed(given, shares[reverse], neighbours),
            None,
        )


def _products(left: Tensor, right: Tensor, neighbours: Neighbours) -> Tensor:
    """Inner product of the source's row and the target's, for every pair."""
    rows = left.index_select(0, neighbours.sources)
    return rows.mul_(right.index_select(0, neighbours.targets)).sum(dim=1)


def _sums(values: Tensor, neighbours: Neighbours) -> Tensor:
    """Sum over the pairs of each source."""
    total = values.new_zeros(len(neighbours.starts))
    return total.index_add_(0, neighbours.sources, values)


def _mixed(values: Tensor, shares: Tensor, neighbours: Neighbours) -> Tensor:
    """Weighted sum, for each source, of the rows of its targets."""
    return functional.embedding_bag(
        neighbours.targets, values, neighbours.starts, mode="sum", per_sample_weights=shares
    )
