"""One whole training step of method 3dgs: render, loss, backward, optimiser, density statistics."""

from dataclasses import replace

import torch

from splatproof.base.errors import MissingError, SplatproofError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.catalogue.registry import find_scene
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import Scene
from splatproof.suites.twins.twin import Case, Component, Forward, Leaves, Problem, Size, Twin

SCENE = "brighton_beach"
STAND_IN = "courtyard"
PATIENCE = 6_000
"""Most steps until the model has grown to the wished size."""
GROWN = 0.95
"""Share of that size from which on steps are timed; pruning keeps it below the cap."""


def scene() -> Scene:
    """The measured scene 250 px wide; the self-made one where it is not on this machine."""
    try:
        return open_scene(SCENE, load_protocol("brighton_250"))
    except MissingError:
        return open_scene(STAND_IN, replace(load_protocol("default"), width=250))


def trained(size: Size) -> Problem:
    """A run of 30,000 steps that holds size[0] Gaussians, its cap: what is timed does not grow."""
    return Problem(leaves={}, given={"scene": scene(), "gaussians": size[0]})


def iterates(problem: Problem, _: Leaves) -> Forward:
    """`start` that trains until the model is large enough; then a forward pass is one step.

    Args:
        problem: Scene, and number of Gaussians to grow to.
        _: Leaves of the problem; there are none.
    """
    given = problem.given
    settings = Settings(density=Density(most=given["gaussians"]))
    model, plan = prepare(given["scene"], settings, Run())
    trainer = Trainer(model, plan, Run())
    enough = GROWN * given["gaussians"]
    while model.primitives < enough and trainer.step < PATIENCE:
        trainer.advance()
    found = model.primitives
    if found < enough:
        raise SplatproofError(
            f"{found} Gaussians after {PATIENCE} steps, expected {given['gaussians']}: "
            "this scene does not grow so far"
        )
    return lambda: torch.tensor(trainer.advance()["loss"])


def label(size: Size) -> str:
    """E.g. brighton_beach 250 px, 10000 Gaussians."""
    try:
        find_scene(SCENE)
        name = SCENE
    except MissingError:
        name = STAND_IN
    return f"{name} 250 px, {size[0]} Gaussians"


TRAINING = Component(
    name="training step",
    problem=trained,
    reference=None,
    twins=(Twin(name="3dgs cpu", start=iterates),),
    usual="3dgs cpu", judged=(0,), tiny=(0,),
    cases=(Case(size=(10_000,)), Case(size=(50_000,))),
    label=label,
)  # fmt: skip
