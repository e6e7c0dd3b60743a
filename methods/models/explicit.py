"""What training leaves behind: something that renders, is saved, and is loaded again."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof import __version__
from splatproof.base.errors import DataError
from splatproof.base.files import sha256, write_text
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.backends import get_backend
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.render import RenderOutput

FORMAT = "splatproof model"
FORMAT_VERSION = 1
ARRAYS = "model.safetensors"
DESCRIPTION = "model.json"
KINDS = ("explicit", "city")
FIELDS = ("means", "quaternions", "log_scales", "opacity_logits", "sh")


@runtime_checkable
class Reconstruction(Protocol):
    """A trained model of a scene."""

    @property
    def primitives(self) -> int:
        """Number of Gaussians that are stored."""
        ...

    def render(self, camera: Camera, background: Float[Tensor, "3"] | None = None) -> RenderOutput:
        """The image from a camera; background None is black. No gradients."""
        ...

    def gaussians(self) -> Gaussians:
        """The model as explicit Gaussians in the scene's frame."""
        ...

    def save(self, folder: Path) -> None:
        """Write the model folder."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplicitModel:
    """Gaussians and what is needed to draw and export them."""

    kind: ClassVar[str] = "explicit"
    """What load_reconstruction tells models apart by."""
    model: Gaussians
    method: str
    """Name of the row that made it; "import" for a foreign file."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Every setting it was made with, JSON-ready."""
    mode: Mode = "classic"
    """How it is rasterized, see splatproof.reference.rasterizer.rasterize."""
    shift: Float[Tensor, "3"] = field(default_factory=lambda: torch.zeros(3, dtype=torch.float64))
    """Float64; added to the means it gives positions in the original frame."""
    units: str = "sfm"
    """Name of the length unit."""
    backend: str = "cpu"
    """Name of the rasterizer; not stored."""

    @property
    def primitives(self) -> int:
        """Number of Gaussians."""
        return len(self.model)

    def gaussians(self) -> Gaussians:
        """The Gaussians, in the scene's frame."""
        return self.model

    @torch.no_grad()
    def render(self, camera: Camera, background: Float[Tensor, "3"] | None = None) -> RenderOutput:
        """The image from a camera, not clamped; background None is black."""
        model = self.model
        return get_backend(self.backend).rasterize(
            camera, model.means, model.quaternions, model.scales, model.opacities,
            sh=model.sh, background=background, mode=self.mode,
        )  # fmt: skip

    def arrays(self) -> dict[str, Tensor]:
        """What model.safetensors holds."""
        return {name: getattr(self.model, name) for name in FIELDS}

    def more(self, folder: Path) -> dict[str, Any]:
        """Write what other files a kind of model has; what model.json says of them."""
        del folder
        return {}

    def save(self, folder: Path) -> None:
        """Write `folder`/model.safetensors and, last, model.json, which holds its hash.

        A folder that was interrupted has no model.json and is refused by `load_reconstruction`.
        """
        (folder / DESCRIPTION).unlink(missing_ok=True)
        write_tensors(folder / ARRAYS, self.arrays())
        write_description(
            folder, method=self.method, settings=self.settings, mode=self.mode, shift=self.shift,
            units=self.units, primitives=self.primitives, degree=self.model.degree,
            kind=self.kind, more=self.more(folder),
        )  # fmt: skip


def write_description(
    folder: Path,
    *,
    method: str,
    settings: Mapping[str, Any],
    mode: Mode,
    shift: Float[Tensor, "3"],
    units: str,
    primitives: int,
    degree: int,
    kind: str = ExplicitModel.kind,
    more: Mapping[str, Any] | None = None,
) -> None:
    """Write model.json beside arrays that lie there complete: it holds their hash.

    Args:
        folder: With model.safetensors.
        method: As in ExplicitModel, like settings, mode, shift and units.
        settings: JSON-ready.
        mode: How the model is rasterized.
        shift: Float64; back to the original frame.
        units: Name of the length unit.
        primitives: Number of Gaussians.
        degree: Of the spherical harmonics.
        kind: One of KINDS.
        more: What that kind of model says besides.
    """
    facts = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "kind": kind,
        "method": method,
        "settings": dict(settings),
        "mode": mode,
        "shift": shift.tolist(),
        "units": units,
        "primitives": primitives,
        "degree": degree,
        "arrays_sha256": sha256(folder / ARRAYS),
        "versions": {"splatproof": __version__, "torch": torch.__version__},
    } | dict(more or {})
    write_text(folder / DESCRIPTION, json.dumps(facts, indent=2) + "\n")


def describe(folder: Path) -> dict[str, Any]:
    """What model.json says, checked to be of a kind and version that can be read here.

    Raises: DataError, naming the file and what is wrong with it.
    """
    path = folder / DESCRIPTION
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file. Expected a folder written by `bench fit`") from None
    except (ValueError, OSError) as error:
        raise DataError(f"{path}: not JSON ({error})") from None
    if not isinstance(facts, dict) or facts.get("format") != FORMAT:
        raise DataError(f"{path}: not a model of splatproof (no format {FORMAT!r})")
    if facts.get("version") != FORMAT_VERSION:
        raise DataError(
            f"{path}: version {facts.get('version')!r}, this splatproof reads {FORMAT_VERSION}; "
            "use the version that wrote it"
        )
    if facts.get("kind") not in KINDS:
        raise DataError(f"{path}: kind {facts.get('kind')!r}, expected {' or '.join(KINDS)}")
    return facts


def load_reconstruction(folder: Path, *, backend: str = "cpu") -> Reconstruction:
    """The model that `save` wrote into a folder, or a packed one.

    Args:
        folder: With model.json and model.safetensors; or a file of methods.storage.packed.writer.
        backend: Name of the rasterizer to draw it with.

    Raises: DataError, in one line, if a file is missing, damaged, foreign or of a newer version.
    """
    if folder.is_file():
        from splatproof.methods.storage.packed.reader import read_packed  # it builds on this module

        model, packed = read_packed(folder)
        check_gaussians(model, folder)
        return ExplicitModel(model=model, backend=backend, **vars(packed))
    facts = describe(folder)
    path = folder / ARRAYS
    arrays, _ = read_tensors(path)
    if sha256(path) != facts.get("arrays_sha256"):
        raise DataError(
            f"{path}: its sha256 is not the one in {DESCRIPTION}; copy the folder again"
        )
    if facts["kind"] == "city":
        from splatproof.methods.city.model import load_city  # it builds on this module

        return load_city(folder, facts, arrays, backend=backend)
    model = gaussians_in(arrays, path)
    try:
        return ExplicitModel(model=model, backend=backend, **described(facts))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{folder / DESCRIPTION}: damaged ({error!r})") from None


def gaussians_in(arrays: Mapping[str, Tensor], source: Path) -> Gaussians:
    """The Gaussians among named arrays, checked.

    Raises: DataError, naming `source`.
    """
    missing = [name for name in FIELDS if name not in arrays]
    if missing:
        raise DataError(f"{source}: no array {missing[0]!r}. Expected {', '.join(FIELDS)}")
    model = Gaussians(**{name: arrays[name] for name in FIELDS})
    check_gaussians(model, source)
    return model


def described(facts: Mapping[str, Any]) -> dict[str, Any]:
    """What model.json says that any model has beside its arrays.

    Raises: KeyError, TypeError or ValueError for what is missing or wrong.
    """
    shift = torch.tensor(facts["shift"], dtype=torch.float64)
    if shift.shape != (3,):
        raise ValueError(f"shift has shape {tuple(shift.shape)}, expected 3 numbers")
    if facts["mode"] not in ("classic", "antialiased"):
        raise ValueError(f"mode {facts['mode']!r}, expected 'classic' or 'antialiased'")
    return {
        "method": str(facts["method"]), "settings": dict(facts["settings"]),
        "mode": facts["mode"], "shift": shift, "units": str(facts["units"]),
    }  # fmt: skip


def check_gaussians(model: Gaussians, source: Path) -> None:
    """Refuse wrong shapes and numbers that are not finite, naming the first.

    Raises: DataError, naming `source`.
    """
    count, bands = len(model.means), model.sh.shape[1:2]
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
    if not math.isfinite(count) or count == 0:
        raise DataError(f"{source}: no Gaussians")
