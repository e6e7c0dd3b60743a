"""Soft ranks: the direct sum against ranks that are counted."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.reference.supervision import soft_rank
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

TEMPERATURE = 0.1
"""In the unit of the values, whose standard deviation is 1."""


def samples(size: Size) -> Problem:
    """Normal numbers, one a sampled pixel. Ranks are divided by their number: the error's unit."""
    draw = torch.Generator().manual_seed(size[0])
    values, cotangent = (torch.randn(size[0], generator=draw) for _ in range(2))
    return Problem(leaves={"values": values}, cotangent=cotangent)


def direct(leaves: Leaves, _: Mapping[str, Any]) -> Tensor:
    """The definition.

    Args:
        leaves: Inputs by name; outputs depend on them.
        _: Everything else of the problem, by name; not needed here.
    """
    values = leaves["values"]
    return soft_rank.soft_rank(values, TEMPERATURE) / len(values)


def counted(leaves: Leaves, _: Mapping[str, Any]) -> Tensor:
    """Discrete ranks by sorting: how many lie above, and a half; the gradient is zero.

    Args:
        leaves: Inputs by name; outputs depend on them.
        _: Everything else of the problem, by name; not needed here.
    """
    values = leaves["values"]
    ranks = torch.empty_like(values)
    order = torch.argsort(values.detach(), descending=True, stable=True)
    ranks[order] = torch.arange(len(values), dtype=values.dtype)
    return (ranks + 0.5) / len(values) + 0 * values


SOFT_RANK = Component(
    name="soft rank",
    problem=samples,
    reference=Twin(name="reference float64", start=functional(direct), dtype=torch.float64),
    twins=(
        Twin(name="direct", start=functional(direct)),
        Twin(name="sorted", start=functional(counted),
             approximates="ranks are discrete, so their gradient is zero"),
    ),
    usual="direct", judged=(1_000,), tiny=(50,),
    cases=(Case(size=(4_000,)),),
)  # fmt: skip
