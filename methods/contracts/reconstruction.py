"""What training leaves behind: a reconstruction that renders views, and the folder it is saved in."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof import __version__
from splatproof.base.errors import DataError
from splatproof.base.files import read_json, sha256, write_text
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.result import NO_PRIOR, TRUE_POSES
from splatproof.reference.types.scene import View

FORMAT = "splatproof model"
FORMAT_VERSION = 1
ARRAYS = "model.safetensors"
DESCRIPTION = "model.json"


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Where a model comes from: enough to render the views it was made for and to make it again."""

    method: str = "import"
    """Name of the method that made it; "import" for a foreign file."""
    variant: str = ""
    """Name of the variant of that method in its suite; empty: none."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Every setting it was made with, JSON-ready."""
    scene: str = ""
    """Name or folder of the scene it was trained on; empty: unknown."""
    protocol: Mapping[str, Any] = field(default_factory=dict)
    """Every rule of the protocol it was trained under, JSON-ready; empty: unknown."""
    seed: int | None = None
    """Seed of the run; None: unknown."""
    pose_noise: str = TRUE_POSES
    """Level of the noise on the poses that it was trained under, see
    `splatproof.datasets.pose_noise`."""
    depth_prior: str = NO_PRIOR
    """Short name of the depth prior that its training views had, see `splatproof.methods.priors`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stored:
    """What a model consists of on disk, beside files of its own."""

    tensors: Mapping[str, Tensor]
    """Arrays of model.safetensors, by name."""
    facts: Mapping[str, Any]
    """What model.json says of it, JSON-ready; with `primitives`."""


@runtime_checkable
class Reconstruction(Protocol):
    """A trained model of a scene."""

    @property
    def kind(self) -> str:
        """Name by which the loader of such models is found."""
        ...

    @property
    def primitives(self) -> int:
        """Number of Gaussians or anchors that are stored."""
        ...

    def render(self, view: View, background: Float[Tensor, "3"] | None = None) -> RenderOutput:
        """The image of a view: camera, time, sensor and appearance. No gradients.

        Args:
            view: What is looked at; its image and truth are not.
            background: Colour behind everything; None is black.
        """
        ...

    def store(self, folder: Path) -> Stored:
        """What `save_model` writes; writes files of its own into `folder` first, if it has any."""
        ...


@runtime_checkable
class Bakes(Protocol):
    """A reconstruction that can be turned into explicit Gaussians."""

    def bake(self, view: View | None = None) -> Gaussians:
        """Explicit Gaussians in the scene's frame, on the CPU, as they are at a view.

        Args:
            view: Whose camera, time and appearance count; None where the model needs none.

        Raises: UsageError if the model needs a view and gets none.
        """
        ...


@runtime_checkable
class Adapts(Protocol):
    """A reconstruction with an appearance that can be fitted to a part of an image."""

    def fit_appearance(
        self,
        view: View,
        image: Float[Tensor, "h w 3"],
        columns: slice,
        mask: Bool[Tensor, "h w"] | None = None,
    ) -> Float[Tensor, " c"]:
        """Code that shows a view in the light of an image, to be put into View.appearance.

        Args:
            view: Camera, time and sensor of the image.
            image: The columns of the image that may be looked at, in [0, 1].
            columns: Which columns of the whole image they are.
            mask: Which of their pixels may be looked at; None: all.
        """
        ...


def save_model(model: Reconstruction, folder: str | Path, origin: Origin) -> None:
    """Write `folder`/model.safetensors and, last, model.json, which holds its hash.

    A folder that was interrupted has no model.json and is refused when it is loaded.

    Args:
        model: What is saved.
        folder: Made where it is missing.
        origin: Where the model comes from.
    """
    folder = Path(folder)
    (folder / DESCRIPTION).unlink(missing_ok=True)
    stored = model.store(folder)
    write_tensors(folder / ARRAYS, stored.tensors)
    write_description(folder, model.kind, origin, stored.facts)


def write_description(folder: Path, kind: str, origin: Origin, facts: Mapping[str, Any]) -> None:
    """Write model.json beside arrays that lie there complete: it holds their hash.

    Args:
        folder: The model's folder; model.safetensors lies there already.
        kind: What the model is loaded as.
        origin: Where the model comes from.
        facts: What that kind of model says besides, JSON-ready.
    """
    told = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "kind": kind,
        "origin": asdict(origin),
        **facts,
        "arrays_sha256": sha256(folder / ARRAYS),
        "versions": {"splatproof": __version__, "torch": torch.__version__},
    }
    write_text(folder / DESCRIPTION, json.dumps(told, indent=2) + "\n")


def describe(folder: Path) -> dict[str, Any]:
    """What model.json says, checked to be of a version that can be read here.

    Raises: DataError, naming the file and what is wrong with it.
    """
    path = folder / DESCRIPTION
    if not os.path.lexists(path):
        raise DataError(f"{path}: no such file. Expected a folder written by `bench fit`")
    facts = read_json(path)
    if not isinstance(facts, dict) or facts.get("format") != FORMAT:
        raise DataError(f"{path}: not a model of splatproof (no format {FORMAT!r})")
    if facts.get("version") != FORMAT_VERSION:
        raise DataError(
            f"{path}: version {facts.get('version')!r}, this splatproof reads {FORMAT_VERSION}; "
            "use the version that wrote it"
        )
    return facts


def origin_of(folder: Path) -> Origin:
    """Where the model of a folder comes from.

    Raises: DataError if its model.json is missing, damaged or of another version.
    """
    told = describe(folder).get("origin")
    names = {part.name for part in fields(Origin)}
    older = {"depth_prior"}  # a model from before priors does not say it
    if not isinstance(told, dict) or not names - older <= set(told) <= names:
        raise DataError(f"{folder / DESCRIPTION}: damaged (origin is {told!r})")
    return Origin(**told)


def read_stored(folder: Path) -> Stored:
    """Arrays and facts of a model folder, the arrays checked against their hash.

    Raises: DataError, in one line, if a file is missing, damaged, foreign or of a newer version.
    """
    facts, path = describe(folder), folder / ARRAYS
    tensors, _ = read_tensors(path)
    if sha256(path) != facts.get("arrays_sha256"):
        raise DataError(
            f"{path}: its sha256 is not the one in {DESCRIPTION}; copy the folder again"
        )
    return Stored(tensors=tensors, facts=facts)


def require_kind(facts: Mapping[str, Any], known: Mapping[str, object], folder: Path) -> str:
    """Name of the kind of model that a model.json tells of.

    Args:
        facts: What model.json says.
        known: Kinds that can be loaded here, by name.
        folder: Where it lies, for the error.

    Raises: DataError for a kind that nothing here can load.
    """
    kind = facts.get("kind")
    if not isinstance(kind, str) or kind not in known:
        raise DataError(
            f"{folder / DESCRIPTION}: kind {kind!r}, this installation loads "
            f"{', '.join(sorted(known))}; install the package whose method "
            "made it, or name its file with --plugin"
        )
    return kind
