"""One finished case: the record that everything downstream is derived from."""

import math
import re
from dataclasses import dataclass, field
from pathlib import PurePosixPath

AROUND = ("load", "init", "save", "score")
"""Stages that every method has around its own."""
BEGAN, ENDED, BOOT = "training began", "training ended", "boot"
"""Where an environment says when a case was trained (ISO 8601, UTC), and by a hash that changes with the
machine and its every start, on which."""
MOMENTS = (BEGAN, ENDED, BOOT)
"""What differs between two runs of the same code in the same place."""

TRUE_POSES = "none"
"""Level of pose noise of a case whose training views keep their poses."""


NO_PRIOR = "none"
"""Depth prior of a case whose training views have none."""


def row_name(
    method: str, variant: str, pose_noise: str = TRUE_POSES, depth_prior: str = NO_PRIOR
) -> str:
    """What a table calls its row: method@variant~pose-noise-LEVEL~depth-PRIOR, of these what is there.

    Args:
        method: Name of the method.
        variant: What a suite calls the method's settings; "" where it has none but these.
        pose_noise: Level of the noise on the poses of training views.
        depth_prior: Depth prior of the training views as `prior_name` shortens it.
    """
    row = f"{method}@{variant}" if variant else method
    row += "" if pose_noise == TRUE_POSES else f"~pose-noise-{pose_noise}"
    return row + ("" if depth_prior == NO_PRIOR else f"~depth-{depth_prior}")


def prior_name(depth_prior: str) -> str:
    """Short name of a depth prior, fit for a folder: of KIND:PATH the path's last part alone.

    The weights behind the path are told apart by their hash, which a record has among its facts.

    >>> prior_name("oracle+noise"), prior_name("network:/weights/street v2.safetensors")
    ('oracle+noise', 'network-street-v2')
    """
    kind, colon, path = depth_prior.partition(":")
    return f"{kind}-{re.sub(r'[^a-zA-Z0-9_.-]', '-', PurePosixPath(path).stem)}" if colon else kind


def picture_name(image: str) -> str:
    """File name of a view's pictures: its name with "-" for "/", ending .png.

    Data sets with several cameras or blocks give files of different folders the same name.
    """
    return PurePosixPath(image).with_suffix(".png").as_posix().replace("/", "-")


@dataclass(frozen=True, kw_only=True)
class ImageScore:
    """The scores of one test image."""

    name: str
    """Name of the view."""
    truth_sha256: str
    """Hash of the truth's pixels as scored (float32 bytes, row-major)."""
    valid_share: float
    """Share of pixels that were scored, in [0, 1]."""
    metrics: dict[str, float]
    """Metric name to value; nan where undefined."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """Scene x method x settings x seed x protocol, and what came out. Plain data, JSON-ready."""

    suite: str
    scene: str
    method: str
    seed: int
    protocol: str
    """Name of the protocol; its rules stand in protocol_rules."""
    protocol_rules: dict[str, object]
    settings: dict[str, object]
    """Every setting of the method, defaults included."""
    variant: str = ""
    """What a suite calls these settings where it runs a method with several; "": it has one."""
    pose_noise: str = TRUE_POSES
    """Level of the noise that the poses of training views had; see datasets.pose_noise."""
    depth_prior: str = NO_PRIOR
    """Depth prior that training views had, as `prior_name` shortens it; see methods.priors."""
    images: tuple[ImageScore, ...]
    """Scores of the test images, sorted by name."""
    metrics: dict[str, float]
    """Means over images of each per-image metric, then scene-level ones (psnr_of_mean_mse)."""
    stages: dict[str, float]
    """Wall seconds by stage: load, init, the method's own (train, or those of a city), save, score."""
    cpu_seconds: float
    peak_memory_mb: float
    """Peak resident memory of the process during the case, in 2^20 bytes."""
    primitives: int
    bytes_on_disk: int
    """Bytes of the saved model."""
    render_ms: float
    """Median milliseconds a test frame after warm-up, without I/O."""
    turns: str = ""
    """Name of the session in which this model was drawn in turns with others, which `render_ms` is of then; "": it is
    of right after the case's own training."""
    split_sha256: str
    """Hash of the train and test name lists."""
    model_sha256: str
    """Hash of the saved model's arrays."""
    curve: tuple[tuple[int, dict[str, float]], ...] = ()
    """Pairs (step, values by name) that were logged while training."""
    curve_seconds: tuple[float, ...] = ()
    """Wall seconds since the fit began at each point of the curve, over all attempts; empty: not known."""
    timed: tuple[tuple[float, dict[str, float]], ...] = ()
    """Pairs (wall seconds, mean of each metric) of the model as it was at the case's marks; seconds count
    from the opening of the scene. () where it has none."""
    counters: dict[str, int] = field(default_factory=dict)
    """Work that was done, by name: steps, pairs (of Gaussian and tile, all views of the training),
    densifications, rows_added, rows_removed, resets, see `splatproof.methods.training.counts`; least_visits
    (how often training visited the photo that it visited least; of a scene in blocks the least of all blocks, each by its own
    photos); and render_pairs (of the held-out views). The same bits of code, data, seed and SIMD level give the
    same numbers, however busy the machine is. Without what a method or backend does not count."""
    environment: dict[str, str] = field(default_factory=dict)
    """Versions, git commit, machine, threads, SIMD level, backend."""
    scene_facts: dict[str, str] = field(default_factory=dict)
    left_out: tuple[tuple[str, str], ...] = ()
    suite_scenes: tuple[str, ...] = ()
    """Every scene that the suite declares: a mean over scenes is given only where all are there."""
    error: str = ""
    """One line saying why the case failed; empty for a finished one."""

    @property
    def row(self) -> str:
        """What a table calls the method with these settings, noise and prior; see `row_name`."""
        return row_name(self.method, self.variant, self.pose_noise, self.depth_prior)

    @property
    def training_seconds(self) -> float:
        """Wall seconds of the method's own stages; nan where none was measured."""
        if "train" in self.stages:
            return self.stages["train"]
        own = [seconds for stage, seconds in self.stages.items() if stage not in AROUND]
        return sum(own) if own else math.nan
