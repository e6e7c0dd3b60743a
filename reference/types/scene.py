"""What a method is trained and tested on: views, sparse points and their split."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NoReturn

from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from splatproof.base.errors import SplatproofError
from splatproof.reference.types.camera import Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """What a LiDAR measured around the moment of one view."""

    positions: Float[Tensor, "n 3"]
    """Float32, scene units, scene frame: where rays hit."""
    origin: Float[Tensor, "3"]
    """Float64, scene frame: where the sensor was."""
    time: float | None = None
    """Seconds since the scene's first view; None: unknown."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthPrior:
    """What something else than the photos' own geometry says of the depth of one view."""

    disparity: Float[Tensor, "h w"]
    """Float32, larger where nearer; scale and zero point are unknown, as a monocular network's are."""
    valid: Bool[Tensor, "h w"]
    """Pixels of which it says anything."""


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """One image and the camera that took it. Images are read when asked for, never all at once."""

    name: str
    """File name of the image relative to the scene's image folder; unique in a scene."""
    camera: Camera
    load: Callable[[], Float[Tensor, "h w 3"]]
    """Reads the image: float32 sRGB in [0, 1], exactly camera.height x camera.width."""
    load_mask: Callable[[], Bool[Tensor, "h w"]] | None = None
    """Reads the mask of valid pixels (True: scored and supervised); None: all are valid."""
    load_sky: Callable[[], Bool[Tensor, "h w"]] | None = None
    """Reads the mask of the sky (True: sky) where it is known; None: unknown."""
    load_sweep: Callable[[], Sweep] | None = None
    """Reads the LiDAR sweep that belongs to this view; None: there is none."""
    sweep_time: float | None = None
    """Seconds since the scene's first view: when that sweep was taken, by which views know that they share
    one; None: at the view's own time."""
    load_prior: Callable[[], DepthPrior] | None = None
    """Reads the depth prior that a case was given; None: it has none."""
    time: float | None = None
    """Seconds since the scene's first view; None: static."""
    sensor: str = ""
    """Name of the physical camera where a scene has several."""
    appearance: str | Tensor | None = None
    """Whose light and exposure the view is to be shown in: name of a training view, or a code that
    the model itself fitted. None: its own where it was trained on, else the model's neutral one."""
    load_depth: Callable[[], Float[Tensor, "h w"]] | None = None
    """Truth, for scoring only: reads true z-depth in scene units where it is known (inf: nothing
    hit); None: unknown."""
    load_moving: Callable[[], dict[str, Bool[Tensor, "h w"]]] | None = None
    """Truth, for scoring only: reads the masks of what moves (True: moves) by kind, "vehicles" and
    "people"; None: unknown."""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.camera.height, self.camera.width

    def without_truth(self) -> "View":
        """What may be looked at when the view is rendered: camera, time, sensor and appearance.

        Reading its image raises SplatproofError.
        """
        return View(
            name=self.name, camera=self.camera, load=partial(_hidden, self.name), time=self.time,
            sensor=self.sensor, appearance=self.appearance,
        )  # fmt: skip


def camera_view(camera: Camera, name: str = "", *, time: float | None = None) -> View:
    """A view that nobody took: a camera to render from.

    Args:
        camera: Where it stands.
        name: What pictures of it are called.
        time: Seconds since the scene's first view; None: static.
    """
    return View(name=name, camera=camera, load=partial(_hidden, name or "a camera"), time=time)


def _hidden(name: str) -> NoReturn:
    raise SplatproofError(
        f"view {name}: its image is not for training; train on scene.train_views only"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class SparsePoints:
    """Structure-from-motion points with their tracks as CSR rows of view indices."""

    positions: Float[Tensor, "n 3"]
    """Float64, scene units, scene frame (after the scene's shift)."""
    colours: UInt8[Tensor, "n 3"]
    """sRGB of each point as stored."""
    track_starts: Int[Tensor, " n_plus_1"]
    """CSR: the views of point i are track_views[track_starts[i]:track_starts[i + 1]]."""
    track_views: Int[Tensor, " m"]
    """Indices into Scene.views, each view at most once a point."""

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.positions)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Everything a method may look at, and what it is tested on."""

    name: str
    root: Path | None
    """Folder it was read from; None when it was made in memory."""
    views: tuple[View, ...]
    """All registered views, sorted by name."""
    train: tuple[int, ...]
    """Indices into views that a method may train on."""
    test: tuple[int, ...]
    """Indices into views that are held out."""
    points: SparsePoints
    up: Float[Tensor, "3"]
    """Unit vector against gravity, float64; (0, 0, 1) where the frame is gravity-aligned."""
    units: str
    """Name of the length unit: "metres" or "sfm" (arbitrary scale)."""
    shift: Float[Tensor, "3"]
    """Float64 vector that was subtracted from the original frame; add it back on export."""
    start: float = 0.0
    """Seconds on the original clock at the scene's first view; 0 where no view has a time."""
    left_out: tuple[tuple[str, str], ...] = ()
    """(image name, reason) of every photo that is in the folder but not in the scene."""
    facts: dict[str, str] = field(default_factory=dict)
    """What a result must record: hashes, library versions, how the scene was made."""
    sources: tuple[Path, ...] = ()
    """Files that images, masks, true depth and LiDAR points are read from, sorted."""

    @property
    def train_views(self) -> tuple[View, ...]:
        """The views a method may train on."""
        return tuple(self.views[i] for i in self.train)

    @property
    def test_views(self) -> tuple[View, ...]:
        """The held-out views."""
        return tuple(self.views[i] for i in self.test)

    def for_training(self) -> "Scene":
        """The scene as a method gets it: no truth, and of what does not train no image.

        Training views keep image, mask, sky, sweep and prior; the others keep camera, time and sensor.
        Folder and files are left out, so that nothing hidden is found through them.
        """
        train = set(self.train)
        views = tuple(
            replace(view, load_depth=None, load_moving=None) if i in train else view.without_truth()
            for i, view in enumerate(self.views)
        )
        return replace(self, views=views, root=None, sources=())
