"""Adam's update of all numbers of a model: 59 a Gaussian of degree 3."""

from collections.abc import Callable

import torch

from splatproof.methods.kernels import adam as native
from splatproof.suites.twins.twin import Case, Component, Forward, Leaves, Problem, Size, Twin

NUMBERS = 59
RATE = 1e-2


def update(size: Size) -> Problem:
    """Values and a gradient by them; the forward pass is one update."""
    draw = torch.Generator().manual_seed(size[0])
    values, gradient = (torch.randn(size[0], NUMBERS, generator=draw) for _ in range(2))
    return Problem(leaves={"values": values}, given={"gradient": gradient})


def torch_adam(
    *, foreach: bool = False, fused: bool = False
) -> Callable[[Problem, Leaves], Forward]:
    """`start` of torch.optim.Adam with one of its implementations.

    Args:
        foreach: Take the implementation that updates all tensors in one call an operation.
        fused: Take the implementation with one kernel for the whole update.
    """

    def start(problem: Problem, leaves: Leaves) -> Forward:
        value = torch.nn.Parameter(leaves["values"])
        value.grad = problem.given["gradient"].to(value.dtype)
        optimizer = torch.optim.Adam(
            [value], lr=RATE, eps=native.EPSILON, foreach=foreach, fused=fused
        )

        def step() -> torch.Tensor:
            optimizer.step()
            return value.detach()

        return step

    return start


def native_adam(problem: Problem, leaves: Leaves) -> Forward:
    """`start` of the native update.

    Args:
        problem: Values and the gradient that they are updated with.
        leaves: Copies of the values for this twin.
    """
    value, gradient = leaves["values"], problem.given["gradient"]
    moments = [torch.zeros_like(value) for _ in range(2)]
    numbers = iter(range(1, 2**62))

    def step() -> torch.Tensor:
        native.step([value], [gradient], [moments[0]], [moments[1]], [RATE], next(numbers))
        return value

    return step


ADAM = Component(
    name="adam",
    problem=update,
    reference=Twin(name="reference float64", start=torch_adam(), dtype=torch.float64),
    twins=(
        Twin(name="cpu", start=native_adam),
        Twin(name="torch, one by one", start=torch_adam()),
        Twin(name="torch foreach", start=torch_adam(foreach=True)),
        Twin(name="torch fused", start=torch_adam(fused=True)),
    ),
    usual="cpu", judged=(2_000,), tiny=(40,),
    cases=(Case(size=(10_000,), quick=True), Case(size=(100_000,))),
    label="{0[0]} x 59".format,
)  # fmt: skip
