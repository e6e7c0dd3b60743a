"""Stitching of four blocks: which primitives survive the competition for the rims."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.city import stitch as fast
from splatproof.methods.city.block_model import BlockModel
from splatproof.reference.partition.boxes import OrientedBox
from splatproof.reference.stitching import stochastic as stitching
from splatproof.reference.stitching.stochastic import StitchSettings, TrainedBlock
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

CENTRES = ((0.0, 0.0), (2.0, 0.0), (0.0, 2.0), (2.0, 2.0))
REACH = 1.25
"""Blocks are trained out to this normalised distance: past the rim, as with the paper's margin."""


def blocks(size: Size) -> Problem:
    """Four boxes in a square, size[0] primitives a block, uniform up to REACH."""
    draw = torch.Generator().manual_seed(size[0])
    shape = (len(CENTRES), size[0], 3)
    centre = torch.tensor([(x, y, 0.0) for x, y in CENTRES], dtype=torch.float64)
    means = centre[:, None] + REACH * (2 * torch.rand(shape, generator=draw).double() - 1)
    return Problem(
        leaves={"means": means.float(),
                "opacity_logits": torch.randn(shape[:2], generator=draw),
                "log_scales": torch.randn(shape, generator=draw) - 3},
        given={"centres": centre},
    )  # fmt: skip


def parts(leaves: Leaves, given: Mapping[str, Any]) -> Sequence[tuple[OrientedBox, Leaves]]:
    """Box and parameters of each block.

    Args:
        leaves: Inputs by name; outputs depend on them.
        given: Everything else of the problem, by name.
    """
    eye, half = torch.eye(3, dtype=torch.float64), torch.ones(3, dtype=torch.float64)
    return [
        (OrientedBox(centre=centre, rotation=eye, half=half),
         {name: value[i] for name, value in leaves.items()})
        for i, centre in enumerate(given["centres"])
    ]  # fmt: skip


def by_reference(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The definition: all blocks in memory.

    Args:
        leaves: Inputs by name; outputs depend on them.
        given: Everything else of the problem, by name.
    """
    trained = tuple(TrainedBlock(box=box, **values) for box, values in parts(leaves, given))
    return kept(stitching.stitch(trained, StitchSettings(), torch.Generator().manual_seed(0)))


def by_rims(leaves: Leaves, given: Mapping[str, Any], *, threads: int | None) -> Tensor:
    """The one that cities are stitched with.

    Args:
        leaves: Inputs by name; outputs depend on them.
        given: Everything else of the problem, by name.
        threads: Threads to run on; None: as many as torch has.
    """
    models = []
    for box, values in parts(leaves, given):
        count = len(values["means"])
        rest = {"quaternions": torch.zeros(count, 4), "sh": torch.zeros(count, 1, 3)}
        models.append(BlockModel(region=box, model=Gaussians(**values, **rest)))
    draws = torch.Generator().manual_seed(0)
    return kept(fast.stitch(models, StitchSettings(), draws, threads=threads))


def kept(masks: Sequence[Tensor]) -> Tensor:
    """1 for each primitive that stays, block by block."""
    return torch.cat(list(masks)).double()


def rims(threads: int | None) -> Callable[..., Any]:
    """`start` of the fast one."""
    return functional(partial(by_rims, threads=threads))


STITCHING = Component(
    name="stitching",
    problem=blocks,
    reference=Twin(name="reference float64", start=functional(by_reference), dtype=torch.float64),
    twins=(
        Twin(name="reference", start=functional(by_reference)),
        Twin(name="rims", start=rims(None)),
        Twin(name="rims, 1 thread", start=rims(1)),
    ),
    usual="rims", judged=(2_000,), tiny=(100,), label="4 x {0[0]}".format,
    cases=(Case(size=(10_000,), quick=True), Case(size=(100_000,))),
)  # fmt: skip
