"""What can be chosen about method scaffold-gs."""

import math
from dataclasses import dataclass, field

from splatproof.methods.anchors.control import AnchorDensity
from splatproof.methods.anchors.start import VoxelRule
from splatproof.methods.models.exposure import Exposure
from splatproof.methods.training.schedules import require


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Adam's learning rates, those of the Scaffold-GS release; log-linear from first to last step."""

    offsets: float = 0.05
    """Rate of offsets at the first step. Offsets have no unit; the release multiplies 0.01 by the scene's
    extent, about 5 in its scenes, but 30 and more where the unit is a metre."""
    offsets_final: float = 5e-4
    """Rate of offsets at the last step."""
    features: float = 7.5e-3
    """Rate of anchor features, constant."""
    log_scales: float = 7e-3
    """Rate of log scales, constant."""
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
    bank: float = 0.01
    """Rate of the feature bank's network at the first step."""
    bank_final: float = 1e-5
    """Rate of the feature bank's network at the last step."""

    def __post_init__(self) -> None:
        """Refuse rates that are not finite and >= 0."""
        for name, value in vars(self).items():
            require(math.isfinite(value) and value >= 0, f"rates.{name}", value, ">= 0")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Method scaffold-gs. Steps are those of a 30,000 iteration run; a shorter run shrinks them."""

    iterations: int = 30_000
    """Training steps, `views_per_step` views each."""
    views_per_step: int = 1
    """Views whose mean gradient one step follows (the release: 1)."""
    k: int = 10
    """Gaussians an anchor."""
    features: int = 32
    """Numbers of an anchor's feature, and width of the networks."""
    feature_bank: bool = False
    """Blend features of three resolutions by the viewing direction and distance (on in the paper, off
    in the release)."""
    distance: bool = False
    """Whether the networks also read the distance to the camera (the release: not)."""
    voxel: float = 0.0
    """Edge of a voxel in scene units (the release: 0.001 to 0.01, by the data set); 0: from the points,
    as `voxel_rule` says."""
    voxel_rule: VoxelRule = "distance"
    """How a voxel follows from the points: "distance" makes the coarsest cells as wide as points are
    apart; "squared" takes the squared spacing for a length, as the release does."""
    random_points: int = 0
    """Points that a scene without any starts from, drawn in sight of its cameras; 0: such a scene is
    refused."""
    dssim: float = 0.2
    """Weight of 1 - SSIM; L1 has the rest."""
    volume: float = 0.01
    """Weight of the mean volume of the decoded Gaussians (0.001 in the paper, 0.01 in its release). As in
    the release that is in scene units cubed: where anchors start several units wide it outweighs the
    photos and shrinks what is decoded; where they start far below one it does next to nothing."""
    exposure: Exposure = "off"
    """What is learnt of each photo beside the scene, zero on average over the photos: off: nothing;
    gain: exposure and white balance, as three gains; affine: a 3 x 4 map of its colours."""
    rates: Rates = field(default_factory=Rates)
    density: AnchorDensity = field(default_factory=AnchorDensity)

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("iterations", "views_per_step", "k", "features"):
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        for name in ("voxel", "volume"):
            require(0 <= getattr(self, name) < math.inf, name, getattr(self, name), ">= 0")
        require(self.random_points >= 0, "random_points", self.random_points, ">= 0")
        require(0 <= self.dssim <= 1, "dssim", self.dssim, "0 to 1")
        fits = not self.feature_bank or self.features % 4 == 0
        require(fits, "features", self.features, "a multiple of 4 with feature_bank")
