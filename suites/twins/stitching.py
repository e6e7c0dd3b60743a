"""How primitives of other blocks speak for a place: the mean over the nearest ones."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from scipy.spatial import KDTree
from torch import Tensor

from splatbench.reference import stitching
from splatbench.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

NEIGHBOURS = 5


def neighbours(size: Size) -> Problem:
    """Queries in the rim of a block and the primitives of another one, a tenth as many queries."""
    draw = torch.Generator().manual_seed(size[0])
    count = size[0]
    return Problem(
        leaves={"values": torch.rand(count, generator=draw)},
        given={"means": torch.rand(count, 3, generator=draw, dtype=torch.float64),
               "at": torch.rand(max(1, count // 10), 3, generator=draw, dtype=torch.float64)},
    )  # fmt: skip


def competes(
    mean: Callable[[Tensor, Tensor, Tensor, int], Tensor],
) -> Callable[..., Any]:
    """`start` of a function (at, means, values, k)."""

    def call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
        return mean(given["at"], given["means"], leaves["values"].double(), NEIGHBOURS)

    return functional(call)


def all_threads(at: Tensor, means: Tensor, values: Tensor, k: int) -> Tensor:
    """The k-d tree asked by all cores at once."""
    nearest = KDTree(means.numpy()).query(at.numpy(), k=k, workers=-1)[1]
    return values[torch.as_tensor(nearest)].mean(dim=1)


def every_distance(at: Tensor, means: Tensor, values: Tensor, k: int) -> Tensor:
    """All distances, then the smallest."""
    nearest = torch.cdist(at, means).topk(k, dim=1, largest=False).indices
    return values[nearest].mean(dim=1)


COMPETITION = Component(
    name="stitching competition",
    problem=neighbours,
    reference=Twin(name="reference", start=competes(stitching.nearest_mean), dtype=torch.float64),
    twins=(
        Twin(name="k-d tree", start=competes(stitching.nearest_mean)),
        Twin(name="k-d tree, all cores", start=competes(all_threads)),
        Twin(name="all distances", start=competes(every_distance), most=20_000),
    ),
    usual="k-d tree", judged=(2_000,), tiny=(100,),
    cases=(Case(size=(20_000,), quick=True), Case(size=(200_000,))),
)  # fmt: skip
