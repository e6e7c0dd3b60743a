"""Tallies of single fragments: the definition, pixel by pixel, against the kernel."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.kernels import fragments, rasterizer
from splatproof.reference.density import opacity_spread
from splatproof.suites.twins.random_scenes import speed_scene
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

SHAPE = ("means", "quaternions", "scales", "opacities", "sh")


def scene(size: Size) -> Problem:
    """A random scene and a gradient of its picture, of a tenth or so a pixel; nothing goes back."""
    made, gradient = speed_scene(*size)
    by_colour = gradient * (0.1 * gradient[:, :, 0].numel())
    return Problem(
        leaves={name: getattr(made, name) for name in SHAPE},
        given={"camera": made.camera, "by_colour": by_colour},
    )


def by_definition(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """Every fragment's gradient, and their tallies a pixel of the picture.

    Args:
        leaves: The Gaussians.
        given: Camera and gradient.
    """
    dtype = leaves["means"].dtype
    by_colour = given["by_colour"].to(dtype)
    found = opacity_spread.fragment_gradients(
        given["camera"].to(dtype), leaves["means"], leaves["quaternions"], leaves["scales"],
        leaves["opacities"], leaves["sh"], by_colour,
    )  # fmt: skip
    return opacity_spread.tallied(*found) / by_colour[:, :, 0].numel()


def by_kernel(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
    """The picture, and its tallies.

    Args:
        leaves: The Gaussians.
        given: Camera and gradient.
    """
    moving = leaves["opacities"].detach().requires_grad_()
    with torch.enable_grad():
        drawn = rasterizer.rasterize(
            given["camera"], leaves["means"], leaves["quaternions"], leaves["scales"], moving, sh=leaves["sh"]
        )  # fmt: skip
    return fragments.tallied(drawn, given["by_colour"]) / given["by_colour"][:, :, 0].numel()


FRAGMENTS = Component(
    name="fragments",
    problem=scene,
    reference=Twin(name="reference float64", start=functional(by_definition), dtype=torch.float64),
    twins=(
        Twin(name="cpu", start=functional(by_kernel)),
        Twin(name="torch", start=functional(by_definition), most=300),
    ),
    usual="cpu", judged=(300, 64, 48), tiny=(40, 24, 18),
    cases=(Case(size=(20_000, 320, 240), quick=True), Case(size=(100_000, 800, 600))),
    label="{0[0]} {0[1]}x{0[2]}".format,
)  # fmt: skip
