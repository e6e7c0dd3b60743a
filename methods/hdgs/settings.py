"""What can be chosen about method hdgs."""

import math
from dataclasses import dataclass, field
from typing import Literal

from splatproof.methods.dynamic.settings import LidarSettings, SkySettings
from splatproof.methods.hdgs.consistency import Ice
from splatproof.methods.hdgs.density import HdgsDensity
from splatproof.methods.models.exposure import Exposure
from splatproof.methods.training.schedules import require
from splatproof.reference.anchors.motion_hierarchy import HierarchySettings, by_leaf

KRule = Literal["fixed", "leaf"]
"""How many Gaussians an initial anchor has: `gaussians`; or `leaf` for each anchor of the last layer."""
Motion = Literal["vibration", "static"]
"""How layer 0 moves: about its centre, and is seen around its peak; or not at all, and always."""


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Adam's learning rates; log-linear from first to last step. Those of scaffold-gs where it has them,
    but for features."""

    offsets: float = 0.05
    """Rate of offsets at the first step, in units of an anchor's scale."""
    offsets_final: float = 5e-4
    """Rate of offsets at the last step."""
    features: float = 0.02
    """Rate of features, constant (scaffold-gs: 0.0075, with which training photos are matched 0.4 dB worse
    after 600 steps of world street)."""
    instances: float = 2e-3
    """Rate of instance features, constant."""
    quaternions: float = 1e-3
    """Rate of orientations of base covariances, constant."""
    log_scales: float = 7e-3
    """Rate of log scales, constant."""
    peaks: float = 1e-3
    """Rate of peak times, in tens of frames, constant."""
    velocities: float = 5e-3
    """Rate of velocities, in units of the model a ten frames, at the first step."""
    velocities_final: float = 5e-4
    """Rate of velocities at the last step."""
    log_spans: float = 0.01
    """Rate of log life spans, constant."""
    position: float = 2e-5
    """Rate of the residual networks of positions at the first step; their unit is the model's. Ten times
    this, and `residual`, lost 0.3 dB at moments between those that were trained on: the networks read the
    time, and learn each moment by heart."""
    position_final: float = 2e-6
    """Rate of the residual networks of positions at the last step."""
    residual: float = 2e-4
    """Rate of the residual networks of features and scales at the first step."""
    residual_final: float = 2e-4
    """Rate of the residual networks of features and scales at the last step."""
    ice: float = 2e-3
    """Rate of the consistency step's networks at the first step."""
    ice_final: float = 2e-5
    """Rate of the consistency step's networks at the last step."""
    opacity: float = 2e-3
    """Rate of the opacity network at the first step."""
    opacity_final: float = 2e-5
    """Rate of the opacity network at the last step."""
    shape: float = 4e-3
    """Rate of the network of scales and rotations, constant."""
    colour: float = 8e-3
    """Rate of the colour network at the first step."""
    colour_final: float = 5e-5
    """Rate of the colour network at the last step."""

    def __post_init__(self) -> None:
        """Refuse rates that are not finite and >= 0."""
        for name, value in vars(self).items():
            require(math.isfinite(value) and value >= 0, f"rates.{name}", value, ">= 0")


@dataclass(frozen=True, kw_only=True)
class Smoothing:
    """How training keeps the model smooth between its moments: as PVG does (HDGS does not say)."""

    probability: float = 0.5
    """Probability, 0 to 1, that a step draws a view from the state of another moment, moved on by the
    average velocity of its anchors (PVG's release: 0.5); 0: never. Without, networks that read the time
    learn each moment by heart (row `hdgs@no-smoothing` of suite street)."""
    reach: float = 0.15
    """Greatest time between the two moments in tens of frames (PVG's release: one and a half frames)."""
    decay: float = 1.0
    """How fast the average velocity falls with the span of life in periods (PVG's release: 1)."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(0 <= self.probability <= 1, "smoothing.probability", self.probability, "0 to 1")
        for name in ("reach", "decay"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"smoothing.{name}", value, ">= 0")


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """Depth supervision beside the LiDAR (GDS and LDS)."""

    global_weight: float = 0.0
    """Weight of 1 - rank correlation with the view's depth prior (paper: 0.005); 0: priors are not read.
    Off unless asked for, since a scene has a prior only where its case says so."""
    pixels: int = 1024
    """Pixels that a view's ranks are compared at, drawn at each step; the paper: all."""
    temperature: float = 0.1
    """Temperature of soft ranks, in standard deviations of the disparities."""
    smooth: float = 0.001
    """Weight of the depth's steps between neighbouring pixels where the photo has no edge; 0: off."""
    outlier: float = 0.001
    """Weight of soft ranks far from their neighbourhood's; 0: off."""
    crop: int = 16
    """Edge in pixels of the crop, drawn at each step, whose ranks are looked at."""
    beta: float = 10.0
    """How fast both local weights fall with the strength of an edge of the photo."""
    delta: float = 0.05
    """Share of the crop's pixels that a rank must be off its neighbourhood's by to count."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("global_weight", "smooth", "outlier", "beta", "delta"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"depth.{name}", value, ">= 0")
        require(self.pixels >= 2, "depth.pixels", self.pixels, ">= 2")
        require(self.crop >= 3, "depth.crop", self.crop, ">= 3")
        require(0 < self.temperature < math.inf, "depth.temperature", self.temperature, "> 0")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Method hdgs. Steps are those of a 30,000 iteration run; a shorter run shrinks them."""

    iterations: int = 30_000
    """Training steps, `views_per_step` views each."""
    views_per_step: int = 1
    """Views whose mean gradient one step follows."""
    layers: int = 3
    """Layers N of the hierarchy, 2 to 5. One layer is motion of each Gaussian: method pvg."""
    children: int = 2
    """Children of an anchor in the layers of anchors."""
    k_rule: KRule = "fixed"
    """How many Gaussians K an initial anchor has: "fixed", as many at any N; "leaf", more with N."""
    gaussians: int = 12
    """K of rule "fixed": a multiple of children^(layers - 2)."""
    leaf: int = 6
    """Gaussians an anchor of the last layer of anchors, with rule "leaf"."""
    features: int = 32
    """Numbers of an anchor's feature, and width of the networks."""
    instance: int = 8
    """Numbers of an anchor's instance feature, which its descendants share."""
    period: float = 1.0
    """Period of the vibration, in tens of frames (PVG's release: 1)."""
    motion: Motion = "vibration"
    """How layer 0 moves; residual networks of deeper layers read the time in any case."""
    smoothing: Smoothing = field(default_factory=Smoothing)
    still_span: float = 1.0
    """Life span at the start of anchors that stand still, in durations of the drive (pvg: 1)."""
    moving_span: float = 0.2
    """Life span at the start of anchors on what sweeps found to be moving, in tens of frames (pvg: 0.2)."""
    ice: Ice = "full"
    """Which parts of the consistency step between anchors run."""
    voxel: float = 0.0
    """Edge in scene units of the voxels that start with an anchor where a point is; growing makes
    them half as wide (the paper: 0.001 of a scene's size). 0: from `anchors`."""
    from_sweeps: bool = True
    """Whether anchors start from LiDAR returns too, where and as fast as sweeps say, if the scene has sweeps;
    False: from sparse points alone, at rest, and with lidar.weight = 0 no sweep is read."""
    anchors: int = 10_000
    """Most anchors at the start where `voxel` is 0. With 4,000 training photos of world street are matched
    1.7 dB worse after 600 steps, and more steps hardly help."""
    exposure: Exposure = "off"
    """What is learnt of each photo beside the scene, zero on average over the photos: off: nothing;
    gain: exposure and white balance, as three gains; affine: a 3 x 4 map of its colours."""
    dssim: float = 0.2
    """Weight of 1 - SSIM; L1 has the rest."""
    lidar: LidarSettings = field(
        default_factory=lambda: LidarSettings(weight=0.1, inverse=False, decay=0.0)
    )
    """The LiDAR's term, with depths in the model's unit (paper: weight 0.01, its unit unsaid; 0.1 gains 0.3 dB
    at moments between those that were trained on, one seed)."""
    sky: SkySettings = field(default_factory=lambda: SkySettings(covered=0.5))
    """The sky; pixels that are mostly covered teach it nothing (ours: anchors leave the rims of what was
    photographed open, where the street's leaks on the sky would be seen)."""
    depth: DepthSettings = field(default_factory=DepthSettings)
    rates: Rates = field(default_factory=Rates)
    density: HdgsDensity = field(default_factory=HdgsDensity)

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        several = "2 to 5 (one layer is motion of each Gaussian: method pvg)"
        require(2 <= self.layers <= 5, "layers", self.layers, several)
        counts = ("iterations", "views_per_step", "children", "gaussians", "leaf", "features",
                  "instance", "anchors")  # fmt: skip
        for name in counts:
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        leaves = self.children ** (self.layers - 2)
        fits = self.k_rule == "leaf" or self.gaussians % leaves == 0
        told = f"a multiple of children^(layers - 2) = {leaves}, or k_rule = leaf"
        require(fits, "gaussians", self.gaussians, told)
        for name in ("period", "still_span", "moving_span"):
            require(0 < getattr(self, name) < math.inf, name, getattr(self, name), "> 0")
        require(0 <= self.voxel < math.inf, "voxel", self.voxel, ">= 0")
        require(0 <= self.dssim <= 1, "dssim", self.dssim, "0 to 1")

    @property
    def sizes(self) -> HierarchySettings:
        """Sizes of the hierarchy."""
        sizes = HierarchySettings(
            layers=self.layers, children=self.children, gaussians=self.gaussians,
            features=self.features, instance=self.instance, period=self.period,
        )  # fmt: skip
        return by_leaf(sizes, self.leaf) if self.k_rule == "leaf" else sizes
