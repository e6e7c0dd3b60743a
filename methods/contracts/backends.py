"""The rasterizers a method can train with, and what is missing for those that cannot run here."""

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from splatproof.base.errors import MissingError
from splatproof.base.names import unknown
from splatproof.reference.rasterizer import rasterize as reference_rasterizer
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.splats import Splats

CONTRACT = frozenset({"float32", "float64", "distance", "median", "contributors", "probe"})
"""What the reference rasterizer offers."""


@dataclass(frozen=True, kw_only=True)
class Backend:
    """One implementation of splatproof.reference.rasterizer.rasterize."""

    name: str
    rasterize: Callable[..., RenderOutput]
    """Same signature and meaning as the reference."""
    capabilities: frozenset[str]
    """Subset of CONTRACT that this implementation offers."""
    missing: str = ""
    """What to install before it can be used; empty when it is ready."""
    device: str = "cpu"
    """Kind of torch device that it draws on, and that models and images are kept on for it."""
    again: Callable[..., RenderOutput] | None = None
    """again(drawn, camera, means, quaternions, scales, opacities, colours=...): what `rasterize` makes of other
    colours of Gaussians that it drew, sooner; `drawn` is that picture, with a gradient. None: it cannot."""
    tally: Callable[[RenderOutput, Tensor], Tensor] | None = None
    """tally(drawn, by_colour): `reference.density.opacity_spread.tallied` of a picture that `rasterize` drew, with
    a gradient; None: it cannot."""
    count_pairs: Callable[[], int] | None = None
    """Pairs of Gaussian and tile of all pictures of this process so far; None: it does not count."""

    @property
    def counts_pairs(self) -> bool:
        """Whether `pairs` tells anything."""
        return self.count_pairs is not None

    def pairs(self) -> int:
        """Pairs of Gaussian and tile of all pictures of this process so far; 0 if it does not count."""
        return 0 if self.count_pairs is None else self.count_pairs()

    def draw(self, camera: Camera, splats: Splats, **asked: Any) -> RenderOutput:
        """The image of splats.

        Args:
            camera: Where it is taken from.
            splats: On any device; the result is on the same.
            asked: background, mode, probe and the further outputs of `rasterize`. Where splats have
                the channels of several images, the background is that of each.
        """
        background, colours = asked.get("background"), splats.colours
        if background is not None and colours is not None:
            asked["background"] = background.repeat(colours.shape[1] // len(background))
        return self.rasterize(
            camera, splats.means, splats.quaternions, splats.scales, splats.opacities,
            sh=splats.sh, colours=colours, **asked,
        )  # fmt: skip


def _reference() -> Backend:
    return Backend(
        name="reference", rasterize=reference_rasterizer.rasterize, capabilities=CONTRACT
    )


def _cpu() -> Backend:
    try:
        kernel = importlib.import_module("splatproof.methods.kernels.rasterizer")
        fragments = importlib.import_module("splatproof.methods.kernels.fragments")
    except ImportError as error:
        return _absent("cpu", f"the compiled kernels do not load ({error}); run `pip install .`")
    return Backend(
        name="cpu", rasterize=kernel.rasterize, capabilities=CONTRACT - {"float64"},
        again=kernel.rasterize_again, tally=fragments.tallied, count_pairs=kernel.pairs_listed,
    )  # fmt: skip


def _cuda() -> Backend:
    if importlib.util.find_spec("gsplat") is None:
        return _absent("cuda", "gsplat is not installed; run `pip install splatproof[cuda]`")
    adapter = importlib.import_module("splatproof.methods.contracts.cuda_gsplat")
    if not torch.cuda.is_available():
        return _absent("cuda", "torch finds no CUDA device; use `cpu`")
    return Backend(
        name="cuda", rasterize=adapter.rasterize, capabilities=adapter.CAPABILITIES, device="cuda"
    )  # fmt: skip


def _absent(name: str, missing: str) -> Backend:
    def rasterize(*args: object, **kwargs: object) -> RenderOutput:
        raise MissingError(f"backend {name!r} cannot run here: {missing}")

    return Backend(name=name, rasterize=rasterize, capabilities=frozenset(), missing=missing)


BACKENDS: dict[str, Callable[[], Backend]] = {"reference": _reference, "cpu": _cpu, "cuda": _cuda}


def get_backend(name: str) -> Backend:
    """The backend of that name, ready to use.

    Raises: UsageError for an unknown name; MissingError when something must be installed first.
    """
    if name not in BACKENDS:
        raise unknown("backend", name, BACKENDS)
    backend = BACKENDS[name]()
    if backend.missing:
        raise MissingError(f"backend {name!r} cannot run here: {backend.missing}")
    return backend


def describe_backends() -> tuple[Backend, ...]:
    """All backends, those that cannot run here included (`missing` says why)."""
    return tuple(make() for make in BACKENDS.values())
