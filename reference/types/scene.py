"""What a method is trained and tested on: views, sparse points and their split."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from splatproof.reference.types.camera import Camera


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
    load_depth: Callable[[], Float[Tensor, "h w"]] | None = None
    """Reads true z-depth in scene units where it is known (inf: nothing hit); None: unknown."""
    load_sky: Callable[[], Bool[Tensor, "h w"]] | None = None
    """Reads the mask of the sky (True: sky) where it is known; None: unknown."""
    load_moving: Callable[[], dict[str, Bool[Tensor, "h w"]]] | None = None
    """Reads the masks of what moves (True: moves) by kind, "vehicles" and "people"; None: unknown."""
    time: float | None = None
    """Seconds since the scene's first view; None: static."""
    sensor: str = ""
    """Name of the physical camera where a scene has several."""


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
