"""The native local attention of dlg-gs: every anchor mixes the values of those near it, in float32 on the CPU.

Twin of splatproof.reference.anchors.attention.local_attention, given query, key and value; it differs by rounding only,
except for pairs within rounding of the radius.
"""

import math
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.networks import readable
from splatproof.methods.kernels.rasterizer import plain
from splatproof.methods.kernels.threads import use_threads


def applies(*tensors: Tensor) -> bool:
    """Whether `attend` takes them: float32 on the CPU.

    Args:
        tensors: Query, key, value and centres.
    """
    return readable(tensors)


def lists(starts: Int[Tensor, " n"], targets: Int[Tensor, " e"]) -> _ext.NearLists:
    """Who is near whom, checked once for the many steps that read it.

    Args:
        starts: Where the targets of each anchor begin, ascending from 0.
        targets: Anchors near each anchor, itself among them; where a is near b, b must be near a.

    Raises: ValueError if a list begins before the one before it, or a target is no anchor.
    """
    return _ext.NearLists(starts.contiguous(), targets.contiguous())


def attend(
    near: _ext.NearLists,
    rows: Int[Tensor, " v"],
    query: Float[Tensor, "v dk"],
    key: Float[Tensor, "v dk"],
    value: Float[Tensor, "v dv"],
    *,
    centres: Float[Tensor, "n 3"] | None = None,
    radius: float = math.inf,
    scaled: bool = False,
) -> Float[Tensor, "v dv"]:
    """Softmax(Q K^T / sqrt(d_k)) V of some anchors over those of them that are near.

    Args:
        near: From `lists`, of all anchors.
        rows: Which anchors take part, ascending.
        query: A row an anchor that takes part, as the next two.
        key: What the query is compared with.
        value: What is mixed.
        centres: Where all anchors stand, if not all that are listed count.
        radius: In the unit of the centres: how far those stand that count.
        scaled: Whether the query is over sqrt(d_k) already.

    Raises: ValueError unless `applies` and the shapes fit together.

    Source: DLG-GS, Eqs. 9 to 11; shares made again in the backward pass, so that nothing is kept of a pair: ours.
    """
    if not applies(query, key, value, *([] if centres is None else [centres])):
        raise ValueError("expected torch.float32 on the CPU")
    query = query if scaled else query / math.sqrt(key.shape[1])
    return _Attend.apply(near, rows, plain(centres), radius, query, key, value)


class _Attend(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, near: _ext.NearLists, rows: Tensor, centres: Tensor | None, radius: float,
        *tensors: Tensor,
    ):  # fmt: skip
        query, key, value = (t.detach().contiguous() for t in tensors)
        state = _ext.Attended(near, query, key, value, rows.contiguous(), centres, radius)
        mixed = torch.empty_like(value)
        use_threads()
        _ext.attend(state, mixed)
        ctx.state, ctx.shapes = state, [t.shape for t in tensors]
        return mixed

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        of = plain(grad_outputs[0])
        assert of is not None
        gradients = [of.new_empty(shape) for shape in ctx.shapes]
        use_threads()
        _ext.attend_backward(ctx.state, of, *gradients)
        return None, None, None, None, *gradients
