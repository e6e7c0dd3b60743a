"""Explicit Gaussians as a reconstruction: drawn as they are, baked by doing nothing."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.reconstruction import ARRAYS, DESCRIPTION, Stored
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats, activated

EXPLICIT = "explicit"
"""Kind of models of nothing but Gaussians."""
FIELDS = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
RANKS = (2, 2, 2, 1, 3)
"""Dimensions of each of FIELDS."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplicitModel:
    """Gaussians and what is needed to draw and export them."""

    model: Gaussians
    mode: Mode = "classic"
    """How it is rasterized, see splatproof.reference.rasterizer."""
    shift: Float[Tensor, "3"] = field(default_factory=lambda: torch.zeros(3, dtype=torch.float64))
    """Vector in scene units, float64; added to the means it gives positions in the original
    frame."""
    units: str = "sfm"
    """Name of the length unit."""
    backend: str = "cpu"
    """Name of the rasterizer; not stored."""

    @property
    def kind(self) -> str:
        """Name by which the loader of these models is found."""
        return EXPLICIT

    @property
    def primitives(self) -> int:
        """Number of Gaussians."""
        return len(self.model)

    def bake(self, view: View | None = None) -> Gaussians:
        """The Gaussians, in the scene's frame; they look the same from every view.

        Args:
            view: Not looked at.
        """
        del view
        return self.model

    @torch.no_grad()
    def render(self, view: View, background: Float[Tensor, "3"] | None = None) -> RenderOutput:
        """The image of a view, not clamped.

        Args:
            view: Its camera alone counts: nothing moves, and light is what it was on average.
            background: Colour behind everything; None is black.
        """
        backend = get_backend(self.backend)
        device = self._splats.means.device
        return backend.draw(
            view.camera, self._splats, mode=self.mode,
            background=None if background is None else background.to(device),
        ).to("cpu")  # fmt: skip

    @cached_property
    def _splats(self) -> Splats:
        """The Gaussians, activated once, where the backend draws."""
        device = torch.device(get_backend(self.backend).device)
        return activated(self.model).to(device)

    def store(self, folder: Path) -> Stored:
        """What `save_model` writes: the Gaussians and how they are drawn.

        Args:
            folder: Not used: there are no files beside the arrays.
        """
        del folder
        return Stored(tensors={n: getattr(self.model, n) for n in FIELDS}, facts=self.facts())

    def facts(self) -> dict[str, Any]:
        """What model.json says of any explicit model."""
        return explicit_facts(
            mode=self.mode, shift=self.shift, units=self.units, primitives=self.primitives,
            degree=self.model.degree,
        )  # fmt: skip


def explicit_facts(
    *, mode: Mode, shift: Float[Tensor, "3"], units: str, primitives: int, degree: int
) -> dict[str, Any]:
    """What model.json says of explicit Gaussians.

    Args:
        mode: How they are rasterized.
        shift: Vector in scene units, float64; added to positions it gives those in the original
            frame.
        units: Name of the length unit.
        primitives: Number of Gaussians.
        degree: Degree of the spherical harmonics, 0 to 3.
    """
    return {
        "mode": mode, "shift": shift.tolist(), "units": units, "primitives": primitives,
        "degree": degree,
    }  # fmt: skip


def load_explicit(folder: Path, stored: Stored, backend: str) -> ExplicitModel:
    """The explicit model of a folder whose files were read.

    Args:
        folder: Folder of the model, for errors.
        stored: Arrays and facts that the folder holds.
        backend: Name of the rasterizer to draw it with.

    Raises: DataError, in one line, for what is missing or damaged.
    """
    model = gaussians_in(stored.tensors, folder / ARRAYS)
    try:
        return ExplicitModel(model=model, backend=backend, **described(stored.facts))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{folder / DESCRIPTION}: damaged ({error!r})") from None


def gaussians_in(arrays: Mapping[str, Tensor], source: Path) -> Gaussians:
    """The Gaussians among named arrays, checked.

    Args:
        arrays: Arrays by name; those of FIELDS must be there.
        source: File that they come from, for errors.

    Raises: DataError, naming `source`.
    """
    missing = [name for name in FIELDS if name not in arrays]
    if missing:
        raise DataError(f"{source}: no array {missing[0]!r}. Expected {', '.join(FIELDS)}")
    _check_types(arrays, source)
    model = Gaussians(**{name: arrays[name] for name in FIELDS})
    check_gaussians(model, source)
    return model


def described(facts: Mapping[str, Any]) -> dict[str, Any]:
    """What model.json says that any explicit model has beside its arrays.

    Args:
        facts: What model.json says; mode, shift and units count.

    Raises: KeyError, TypeError or ValueError for what is missing or wrong.
    """
    shift = torch.tensor(facts["shift"], dtype=torch.float64)
    if shift.shape != (3,) or not shift.isfinite().all():
        raise ValueError(f"shift is {facts['shift']!r:.80}, expected 3 finite numbers")
    if facts["mode"] not in ("classic", "antialiased"):
        raise ValueError(f"mode {facts['mode']!r}, expected 'classic' or 'antialiased'")
    return {"mode": facts["mode"], "shift": shift, "units": str(facts["units"])}


def check_gaussians(model: Gaussians, source: Path) -> None:
    """Refuse wrong types and shapes, and numbers that are not finite, naming the first.

    Args:
        model: What is checked.
        source: File it comes from, for errors.

    Raises: DataError, naming `source`.
    """
    count, bands = len(model.means), model.sh.shape[1:2]
    if not count:
        raise DataError(f"{source}: no Gaussians")
    want = {"means": (count, 3), "quaternions": (count, 4), "log_scales": (count, 3),
            "opacity_logits": (count,), "sh": (count, *bands, 3)}  # fmt: skip
    for name in FIELDS:
        values = getattr(model, name)
        if tuple(values.shape) != want[name]:
            raise DataError(
                f"{source}: {name} has shape {tuple(values.shape)}, expected {want[name]}"
            )
        bad = torch.where(~values.reshape(count, -1).isfinite().all(dim=1))[0]
        if len(bad):
            raise DataError(
                f"{source}: {name} of Gaussian {int(bad[0])} is not finite "
                f"({len(bad)} such); remove {'it' if len(bad) == 1 else 'them'} first"
            )
    if bands[0] not in (1, 4, 9, 16):
        raise DataError(f"{source}: {bands[0]} SH bands, expected 1, 4, 9 or 16")


def _check_types(arrays: Mapping[str, Tensor], source: Path) -> None:
    """Refuse arrays of another type or rank than Gaussians have."""
    for name, rank in zip(FIELDS, RANKS, strict=True):
        values = arrays[name]
        if values.dtype != torch.float32 or values.ndim != rank:
            raise DataError(
                f"{source}: {name} is {values.dtype} of shape {tuple(values.shape)}, expected "
                f"torch.float32 of {rank} dimensions"
            )
