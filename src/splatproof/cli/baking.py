"""A trained model as explicit Gaussians: as it is, or as it looks from one view at one time."""

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from splatproof.api.paths import model_path
from splatproof.base.errors import UsageError
from splatproof.cli.models import protocol_of, scene_of
from splatproof.cli.own_cameras import for_model

if TYPE_CHECKING:
    from splatproof.methods.contracts.reconstruction import Reconstruction
    from splatproof.reference.types.gaussians import Gaussians
    from splatproof.reference.types.scene import View


@dataclass(frozen=True, kw_only=True)
class Seen:
    """The one view that a model is written at, where it does not look the same from everywhere."""

    view: str | None = None
    """Name of a view of the model's scene, or of a camera in the file of --cameras."""
    time: float | None = None
    """Seconds since the scene's first view. None: the time of the view."""
    cameras: Path | None = None
    """Look for the view among the cameras in this .json file, as `bench render` reads it."""
    scene: str | None = None
    """Name of a registered scene, or a scene folder, that has the view. None: the scene that the
    model was trained on."""
    protocol: str | None = None
    """Name of a protocol, or the path of a .toml file, that the scene is opened under. None: the
    protocol that the model was trained under."""

    def __post_init__(self) -> None:
        """Refuse what has no effect. Raises: UsageError."""
        named = [f"--{part.name}" for part in fields(self) if getattr(self, part.name) is not None]
        if named and self.view is None:
            raise UsageError(f"{named[0]} belongs to a view; name it with --view NAME")
        if self.time is not None and not math.isfinite(self.time):
            raise UsageError(f"--time is {self.time}, expected a finite number of seconds")
        if self.cameras is not None and {"--scene", "--protocol"} & set(named):
            raise UsageError("--cameras says where the view is; leave --scene and --protocol out")


UNSEEN = Seen()
"""No view is named."""


def view_of(given: Path, model: "Reconstruction", seen: Seen) -> "View | None":
    """The view that is named, without its image; None where none is.

    Args:
        given: The model as the user named it.
        model: What was loaded from there.
        seen: What the user says of the view.
    Raises: UsageError for a view that there is not, or for a model that looks the same from all.
    """
    from splatproof.base.names import unknown
    from splatproof.methods.models.explicit import ExplicitModel

    if seen.view is None:
        return None
    if isinstance(model, ExplicitModel):
        raise UsageError(
            f"{given}: is made of plain Gaussians, which look the same from every view at any time; "
            "leave --view out"
        )
    views = _views(given, model, seen)
    if seen.view not in views:
        raise unknown("--view", seen.view, views)
    view = views[seen.view].without_truth()
    return view if seen.time is None else replace(view, time=seen.time)


def _views(given: Path, model: "Reconstruction", seen: Seen) -> "dict[str, View]":
    """The views among which the user names one."""
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.methods.loading import load_origin
    from splatproof.methods.storage.camera_files import read_cameras

    if seen.cameras is not None:
        return for_model(read_cameras(seen.cameras), model, seen.cameras)
    origin = load_origin(model_path(given))
    scene = scene_of(given, origin, seen.scene)
    return {v.name: v for v in open_scene(scene, protocol_of(given, origin, seen.protocol)).views}


def baked(model: "Reconstruction", view: "View | None") -> "Gaussians":
    """The model as explicit Gaussians.

    Args:
        model: What is turned into Gaussians.
        view: Where it is looked at from; None: nobody says.
    Raises: UsageError, naming the options, for a model that needs a view and gets none, or that
        has no explicit Gaussians.
    """
    from splatproof.methods.contracts.reconstruction import Bakes

    if not isinstance(model, Bakes):
        raise UsageError(f"a model of kind {model.kind!r} cannot be turned into explicit Gaussians")
    try:
        return model.bake(view)
    except UsageError as error:
        if view is not None:
            raise
        raise UsageError(
            f"{error}: --view NAME, where it moves with --time SECONDS; --cameras FILE has views of "
            "your own"
        ) from None
