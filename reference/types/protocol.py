"""The rules that make two numbers comparable. A protocol is data; it is part of a result's key."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How truth images are made, which views are held out, and how renders are scored."""

    name: str
    source: str
    """Where the rules come from: a paper's section, a release, or "ours"."""
    images: str = "photos"
    """Folder of source images inside the scene, e.g. "photos", "images", "images_4"."""
    width: int | None = None
    """Scale so that images have this width (aspect kept); None: use `factor`."""
    factor: float = 1.0
    """Divide both sides by this; 1 leaves the size alone."""
    max_width: int | None = None
    """Scale wider images to this width (aspect kept) and leave the others alone."""
    filter: Literal["area", "lanczos", "bicubic", "bilinear"] = "area"
    """Resampling filter of the down-scale."""
    size_rule: Literal["round", "floor"] = "round"
    """How a scaled size becomes whole pixels (round: half up); K is scaled per axis accordingly."""
    undistort: Literal["crop", "keep"] = "crop"
    """crop: no invalid border pixel is left; keep: all source pixels stay, invalid ones masked."""
    undistort_at: Literal["full", "scaled"] = "full"
    """full: undistort before the down-scale; scaled: after it as OpenSplat does, blurring truth."""
    hold: int = 8
    """Every hold-th of the name-sorted views is test (indices 0, hold, ...); 0: none."""
    hold_first: int = 0
    """Index of the first view (or moment) held out; the next are hold, 2 hold, ... later."""
    hold_unit: Literal["view", "time"] = "view"
    """What is counted: name-sorted views, or moments in time, each with all its cameras."""
    strict: bool = False
    """Refuse a scene whose COLMAP model or transforms.json names photos that are not there; False: they
    are left out, and the scene's `left_out` says so. Other layouts are refused anyway."""
    least_seen: float = 0.0
    """Share of a view's pixels, 0 to 1, that training photos must show where it is held out: a view
    at the survey's rim that they show less of is left to training, and the next one that they show
    this much of is held out in its place (see `splatproof.datasets.seen_split`). 0: not asked."""
    sensors: tuple[str, ...] = ()
    """Names of the cameras that are used, in training and in testing; empty: all."""
    clips: tuple[tuple[str, int, int], ...] = ()
    """(scene's folder, first, last) of drives of which a part is used: moments counted from 0, both
    ends used, last -1: to the end. Other scenes are used whole."""
    test_names: tuple[str, ...] = ()
    """Names of the test views, or patterns such as "test_*"; when given, `hold` is ignored."""
    train_views: int = 0
    """Train on this many views, spread evenly over the name-sorted ones that are not held out. The
    rest of them is test where no other rule holds any out, else not used. 0: train on all."""
    scored: Literal["held-out", "training"] = "held-out"
    """Which views are scored; "training" (reconstruction) says how well a model fits what it saw."""
    test_folder: str = ""
    """Folder inside the scene's, a scene of its own in the same frame: its views are the test views,
    and all of the scene's own are for training (`hold` is ignored)."""
    points: Literal["scene", "triangulated"] = "scene"
    """scene: the sparse points that it has; triangulated: from the training views under their given
    poses, so that nothing of a held-out view is in them."""
    drop_test_points: bool = False
    """Leave out sparse points that only views see which do not train."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """sRGB behind everything, in training and in testing."""
    rounding: Literal["round", "truncate", "float"] = "round"
    """What is done to renders before scoring, after clamping to [0, 1]."""
    masked: bool = True
    """Score valid pixels only; False: all pixels."""
    region: Literal["full", "right_half"] = "full"
    """Part of each test image that is scored."""
    appearance: Literal["none", "nearest", "half", "exposure", "oracle"] = "none"
    """What may be known of a test image's light. nearest: the appearance of the nearest training view,
    of the same sensor where views name theirs; half: a code that the model fits to its left half;
    exposure: an affine map of the render's colours, fitted on its left half, whatever the model; oracle:
    the model sees all of it, and such rows are not ranked. half and exposure need `region` right_half."""
    metrics: tuple[str, ...] = ("psnr", "ssim_3dgs", "ssim_valid", "flip")
    """Per-image metrics by their names in splatproof.metrics.registry; the first one ranks."""
    parts: tuple[Literal["moving", "vehicles", "people", "still"], ...] = ()
    """Extra columns over these parts of an image alone, where it is known what moves; never the main
    column."""
    colour_fit: tuple[Literal["cc_affine", "cc_quadratic"], ...] = ()
    """Extra columns after a colour fit to the truth; never the main column."""


LATER = ("strict", "least_seen")
"""Rules that came after results were kept: where they are as usual, a key does not name them."""


def key_rules(rules: Mapping[str, object]) -> dict[str, object]:
    """Rules as the keys of results hold them: a key from before a rule was there is one of a protocol
    that has it at its default, and what it names is kept.

    Args:
        rules: Every rule by its name.
    """
    usual = {field.name: field.default for field in fields(Protocol)}
    return {n: value for n, value in rules.items() if n not in LATER or value != usual[n]}
