"""Rasterizers, from activated parameters and from raw ones, on random scenes."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import torch
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels import rasterizer as native
from splatproof.methods.kernels.roofline import count_pairs
from splatproof.reference.checks.discontinuities import discontinuity_pixels
from splatproof.reference.rasterizer import rasterize as reference
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene
from splatproof.suites.twins.random_scenes import speed_scene
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

ACTIVATED = ("means", "quaternions", "scales", "opacities", "sh")
Rasterize = Callable[..., Any]

CASES = (
    Case(size=(2_000, 320, 240), quick=True),
    Case(size=(20_000, 320, 240), quick=True),
    Case(size=(100_000, 320, 240)),
    Case(size=(100_000, 800, 600)),
)
GROWTH = (
    *(Case(size=(count, 800, 600), growth=True, quick=count == 10_000)
      for count in (10_000, 30_000, 300_000, 1_000_000)),
    *(Case(size=(100_000, width, width * 3 // 4), growth=True)
      for width in (100, 200, 400, 1600, 3840)),
    Case(size=(5_000_000, 1600, 1200), growth=True, forward_only=True),
)  # fmt: skip


def activated(size: Size) -> Problem:
    """A random scene in the parameters that the image is defined by."""
    return activated_scene(*speed_scene(*size))


def activated_scene(scene: GaussianScene, gradient: Tensor) -> Problem:
    """The problem of one scene.

    Args:
        scene: Gaussians and their camera.
        gradient: Gradient by the colour, height x width x 3.
    """
    leaves = {name: getattr(scene, name) for name in ACTIVATED}
    return _problem(scene.camera, leaves, gradient, lambda: [leaves[n] for n in ACTIVATED[:4]])


def raw(size: Size) -> Problem:
    """The same scene in the parameters that are trained: log scales and opacity logits."""
    scene, gradient = speed_scene(*size)
    leaves = {
        "means": scene.means, "quaternions": scene.quaternions, "log_scales": scene.scales.log(),
        "opacity_logits": scene.opacities.logit(), "sh": scene.sh,
    }  # fmt: skip

    def model() -> list[Tensor]:
        g = Gaussians(**{name: value.double() for name, value in leaves.items()})
        return [g.means, g.quaternions, g.scales, g.opacities]

    return _problem(scene.camera, leaves, gradient, model)


def _problem(
    camera: Any, leaves: Leaves, gradient: Tensor, model: Callable[[], list[Tensor]]
) -> Problem:
    def discontinuities() -> Tensor:
        return discontinuity_pixels(camera, *(value.double() for value in model()), mode="classic")

    return Problem(
        leaves=leaves, given={"camera": camera}, cotangent=gradient, discontinuities=discontinuities,
        pairs=lambda: count_pairs(camera, *model()).contributing,
    )  # fmt: skip


def draws(
    rasterize: Rasterize, keep: int = 16, stored: torch.dtype | None = None
) -> Callable[..., Any]:
    """`start` of a rasterizer with the contract's signature.

    Args:
        rasterize: Function with the signature of the reference's rasterizer.
        keep: Number of SH coefficients that are used, 1, 4, 9 or 16.
        stored: Type that the coefficients are rounded to before they are used; None: their own.
    """

    def call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
        model = [leaves[name] for name in ACTIVATED[:4]]
        sh = leaves["sh"][:, :keep]
        rounded = sh if stored is None else sh.to(stored).to(sh.dtype)
        return rasterize(given["camera"], *model, sh=rounded).colour

    return functional(call)


def pipes(rasterize: Rasterize) -> Callable[..., Any]:
    """`start` of a rasterizer behind the activations of the trained parameters."""

    def call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
        g = Gaussians(**leaves)
        return rasterize(
            given["camera"], g.means, g.quaternions, g.scales, g.opacities, sh=g.sh
        ).colour

    return functional(call)


def label(size: Size) -> str:
    """E.g. 20000 320x240."""
    return f"{size[0]} {size[1]}x{size[2]}"


ONLY_JUDGED = 0
"""`most` of the dense reference: it holds every pair in memory."""

EARLY, NARROW = native.Shortcuts(stop=1 / 255), native.Shortcuts(sigmas=3.0)
"""Shortcuts that have a row of their own."""

RASTERIZER = Component(
    name="rasterizer",
    problem=activated,
    reference=Twin(name="reference float64", start=draws(reference.rasterize), dtype=torch.float64),
    twins=(
        *(Twin(name=f"cpu {level}", start=draws(native.rasterize), level=level)
          for level in _ext.simd_levels()),
        Twin(name="cpu, 1 thread", start=draws(native.rasterize), threads=1),
        Twin(name="cpu, SH of degree 1", start=draws(native.rasterize, keep=4),
             approximates="harmonics of degree 2 and 3 are left out"),
        Twin(name="cpu, SH of degree 0", start=draws(native.rasterize, keep=1),
             approximates="harmonics of degree 1 to 3 are left out"),
        Twin(name="cpu, bf16 harmonics", start=draws(native.rasterize, stored=torch.bfloat16),
             approximates="harmonics are rounded to bfloat16 first, which halves what they take in memory; the kernel "
             "reads floats, so its speed is that of the exact twin and a conversion"),
        Twin(name="cpu, stop at 1/255", start=draws(partial(native.rasterize_roughly, EARLY)),
             approximates="a block ends where less than 1/255 of the light is left of each pixel"),
        Twin(name="cpu, 3 sigma", start=draws(partial(native.rasterize_roughly, NARROW)),
             approximates="blocks of 4 x 4 pixels beyond 3 standard deviations of a Gaussian are left out"),
        Twin(name="torch dense", start=draws(reference.rasterize), most=ONLY_JUDGED),
    ),
    usual=f"cpu {_ext.simd_levels()[-1]}",
    judged=(1_000, 64, 48), tiny=(60, 32, 24), cases=(*CASES, *GROWTH), label=label,
)  # fmt: skip

PIPELINE = Component(
    name="pipeline",
    problem=raw,
    reference=Twin(name="reference float64", start=pipes(reference.rasterize), dtype=torch.float64),
    twins=(
        Twin(name="cpu", start=pipes(native.rasterize)),
        Twin(name="cpu, 1 thread", start=pipes(native.rasterize), threads=1),
    ),
    usual="cpu", judged=(1_000, 64, 48), tiny=(60, 32, 24), cases=CASES, label=label,
)  # fmt: skip
