"""Virtual Gaussians of a view: the field at their places, and a whole training step with explicit ones beside them."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.base.errors import MissingError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.catalogue.registry import find_scene
from splatproof.methods.contracts.run import Run
from splatproof.methods.kernels import field as native
from splatproof.methods.stratosplat.fit import prepare
from splatproof.methods.stratosplat.settings import Planes, StratoSplat
from splatproof.methods.stratosplat.virtual import (
    GRIDS,
    NETWORK,
    drawn_field,
    stack_of,
    unit_field,
    view_sites,
)
from splatproof.methods.training.loop import Trainer
from splatproof.metrics.protocol_files import load_protocol, resized
from splatproof.reference.layered_memory import coordinate_field
from splatproof.reference.types.scene import Scene
from splatproof.suites.twins.layers import EYE, UP, looking
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

SCENE, STAND_IN, PROTOCOL = "brighton_beach", "courtyard", "photos_sparse_3"


def places(size: Size) -> Problem:
    """Where rays of size[0] x size[1] pixels meet the planes, as method stratosplat has them by default; a field at work."""
    width, height = size
    draw = torch.Generator().manual_seed(width)
    spread = torch.tensor([10.0, 10.0, 2.0], dtype=torch.float64)
    cloud = spread * (2 * torch.rand(2000, 3, generator=draw, dtype=torch.float64) - 1)
    planes = Planes()
    view = view_sites(
        stack_of(cloud, UP, planes.count), looking(EYE, width, height, 0.9 * width), planes
    )
    drawn = drawn_field(planes, draw)
    leaves = {
        name: value + 0.1 * torch.randn(value.shape, generator=draw)
        for name, value in drawn.items()
    }
    return Problem(
        leaves=leaves, given={"places": view.places},
        cotangent=torch.randn(len(view.places), leaves["out"].shape[1], generator=draw),
    )  # fmt: skip


def by_kernel(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The field as training asks it.

    Args:
        leaves: Its tensors.
        given: The places.
    """
    grids = [leaves[f"grid_{i}"] for i in range(GRIDS)]
    return native.evaluate(given["places"], grids, [leaves[name] for name in NETWORK])


def by_definition(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The field of the reference.

    Args:
        leaves: Its tensors.
        given: The places.
    """
    return coordinate_field.evaluate(unit_field(leaves), given["places"].to(leaves["out"]))


def sites(size: Size) -> int:
    """Virtual Gaussians of `places`: every ray meets every plane."""
    planes = Planes()
    return planes.count * -(-size[0] // planes.stride) * -(-size[1] // planes.stride)


FIELD = Component(
    name="coordinate field",
    problem=places,
    reference=Twin(name="reference float64", start=functional(by_definition), dtype=torch.float64),
    twins=(
        Twin(name="cpu", start=functional(by_kernel)),
        Twin(name="torch", start=functional(by_definition)),
    ),
    usual="cpu", judged=(80, 60), tiny=(16, 12),
    cases=(Case(size=(200, 150), quick=True), Case(size=(400, 300))),
    label=lambda size: f"{sites(size):,} virtual Gaussians",
)  # fmt: skip


def scene(width: int) -> Scene:
    """Three photos of the measured scene; of the self-made one where it is not on this machine."""
    protocol = resized(load_protocol(PROTOCOL), width)
    try:
        return open_scene(SCENE, protocol)
    except MissingError:
        return open_scene(STAND_IN, protocol)


def start(size: Size) -> Problem:
    """A run from completed depths, on photos size[0] pixels wide."""
    return Problem(leaves={}, given={"width": size[0]})


def iterates(problem: Problem, _: Leaves) -> Callable[[], Tensor]:
    """`start` of training with the default settings; then a forward pass is one step.

    Args:
        problem: The photos' width.
        _: Leaves of the problem; there are none.
    """
    trainer = Trainer(*prepare(scene(problem.given["width"]), StratoSplat(), Run()), Run())
    return lambda: torch.tensor(trainer.advance()["loss"])


def label(size: Size) -> str:
    """E.g. three photos of brighton_beach, 400 px."""
    try:
        find_scene(SCENE)
        name = SCENE
    except MissingError:
        name = STAND_IN
    return f"three photos of {name}, {size[0]} px"


HYBRID = Component(
    name="hybrid step",
    problem=start,
    reference=None,
    twins=(Twin(name="stratosplat cpu", start=iterates),),
    usual="stratosplat cpu", judged=(0,), tiny=(0,),
    cases=(Case(size=(400,)),),
    label=label,
)  # fmt: skip
