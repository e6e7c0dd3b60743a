"""What can be chosen about method pvg. Model time: 0.02 a frame, see `methods.dynamic.times`."""

import math
from dataclasses import dataclass, field

from splatproof.methods.dynamic.settings import LidarSettings, SkySettings
from splatproof.methods.models.exposure import Exposure
from splatproof.methods.training.density import Density
from splatproof.methods.training.schedules import Rates, require
from splatproof.reference.rasterizer.rasterize import Mode


@dataclass(frozen=True, kw_only=True)
class Motion:
    """How Gaussians move and fade (defaults of the PVG release)."""

    period: float = 0.2
    """Period of the swing in model time: ten frames (the release: 0.2)."""
    least_life: float = 0.05
    """Share of its opacity, 0 to below 1, below which a Gaussian is not drawn at a moment (the release:
    0.05)."""
    smoothing: float = 0.5
    """Probability, 0 to 1, that a step draws a view from the state of another moment, moved on by the
    average velocity (the release: 0.5); 0: never."""
    reach: float = 0.03
    """Greatest model time between the two moments: one and a half frames (the release: 0.03)."""
    decay: float = 1.0
    """How fast the average velocity falls with the span of life in periods (the release: 1)."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(0 < self.period < math.inf, "motion.period", self.period, "> 0")
        require(0 <= self.least_life < 1, "motion.least_life", self.least_life, "0 to below 1")
        require(0 <= self.smoothing <= 1, "motion.smoothing", self.smoothing, "0 to 1")
        for name in ("reach", "decay"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"motion.{name}", value, ">= 0")


@dataclass(frozen=True, kw_only=True)
class Start:
    """What training starts from beside the sparse points, and how long things live at first."""

    sweep_points: int = 20_000
    """Most LiDAR returns that Gaussians start from, those of moving things first (the release: 600,000 of
    any); 0: none, and sweeps are not read."""
    velocities: bool = True
    """Whether what moves starts with the velocity that brings its returns onto those of the next sweep;
    False: at rest, as in the release."""
    moving_span: float = 0.04
    """Span of life in model time at the start of what sweeps found to be moving: two frames."""
    still_span: float = 1.0
    """Span of life at the start of everything else, in durations of the drive (the release: everything
    starts at the root of 0.1 to 0.2 durations in model time, 0.32 for fifty frames)."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(self.sweep_points >= 0, "start.sweep_points", self.sweep_points, ">= 0")
        for name in ("moving_span", "still_span"):
            value = getattr(self, name)
            require(0 < value < math.inf, f"start.{name}", value, "> 0")


@dataclass(frozen=True, kw_only=True)
class MovingRates(Rates):
    """Learning rates: those of 3dgs, and of what moves (those of the PVG release)."""

    peaks: float = 8e-4
    """Learning rate of life peaks at the first step, in model time."""
    peaks_final: float = 8e-6
    """Learning rate of life peaks at the last step; log-linear in between."""
    log_spans: float = 2e-3
    """Learning rate of the logarithms of the spans of life."""
    velocities: float = 1e-3
    """Learning rate of velocities, in extents of the scene a unit of model time."""


@dataclass(frozen=True, kw_only=True)
class MovingDensity(Density):
    """Density control in space as for 3dgs, and in time."""

    time_gradient: float = 2e-3
    """Size of the mean gradient by the life peak from which a Gaussian is cloned or split in time (the
    release: 2e-3)."""
    least_span: float = 0.01
    """Span of life in model time up to which a Gaussian is cloned rather than split in time (the release:
    0.01)."""
    time_split: float = 0.5
    """Share of the densification after which children of a split in time live shorter than their parent
    (the release: 0.5); before, they are only spread over its life."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        for name in ("time_gradient", "least_span", "time_split"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"density.{name}", value, ">= 0")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Method pvg. Steps are those of a 30,000 step run; a shorter run shrinks them."""

    iterations: int = 30_000
    """Training steps, `views_per_step` views each (the release: 30,000)."""
    views_per_step: int = 1
    """Views whose mean gradient one step follows (the release: 1)."""
    sh_degree: int = 3
    """Degree of the spherical harmonics, 0 to 3 (the release: 3)."""
    sh_interval: int = 1000
    """Steps after which each further degree is trained (the release: 1000, 2000 for drives)."""
    initial_opacity: float = 0.1
    """Opacity, 0 to 1, of the Gaussians that points become (the release: 0.01)."""
    random_points: int = 0
    """Points that a scene without any starts from, drawn in sight of its cameras; 0: such a scene is
    refused."""
    exposure: Exposure = "off"
    """What is learnt of each photo beside the scene, zero on average over the photos: off: nothing;
    gain: exposure and white balance, as three gains; affine: a 3 x 4 map of its colours."""
    dssim: float = 0.2
    """Weight of 1 - SSIM in the loss, 0 to 1; L1 has the rest (the release: 0.2)."""
    antialiased: bool = False
    """Whether opacities are lowered by as much as the low-pass filter widens a Gaussian."""
    motion: Motion = field(default_factory=Motion)
    start: Start = field(default_factory=Start)
    sky: SkySettings = field(default_factory=SkySettings)
    lidar: LidarSettings = field(default_factory=LidarSettings)
    rates: MovingRates = field(default_factory=MovingRates)
    density: MovingDensity = field(default_factory=MovingDensity)

    @property
    def mode(self) -> Mode:
        """How the model is rasterized."""
        return "antialiased" if self.antialiased else "classic"

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("iterations", "views_per_step"):
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        for name in ("sh_interval", "random_points"):
            require(getattr(self, name) >= 0, name, getattr(self, name), ">= 0")
        require(0 <= self.sh_degree <= 3, "sh_degree", self.sh_degree, "0 to 3")
        opacity = self.initial_opacity
        require(0 < opacity < 1, "initial_opacity", opacity, "between 0 and 1")
        require(0 <= self.dssim <= 1, "dssim", self.dssim, "0 to 1")
