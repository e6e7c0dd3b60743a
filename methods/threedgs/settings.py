"""What can be chosen about row 3dgs."""

import math
from dataclasses import dataclass, field

from splatproof.methods.training.density import Density
from splatproof.methods.training.schedules import Rates, require
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.supervision.dense_initialisation import DenseSettings


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Row 3dgs. Steps are those of a 30,000 iteration run; a shorter run shrinks them in proportion."""

    iterations: int = 30_000
    """Training steps, `views_per_step` views each."""
    views_per_step: int = 1
    """Views whose mean gradient one step follows (the release: 1)."""
    sh_degree: int = 3
    """Degree of the spherical harmonics, 0 to 3."""
    sh_interval: int = 1000
    """Steps until one more SH band is trained."""
    initial_opacity: float = 0.1
    """Opacity of the Gaussians that the sparse points become."""
    random_points: int = 0
    """Points that a scene without any starts from, drawn in sight of its cameras (100,000 in
    gsplat); 0: such a scene is refused. Scenes with points keep theirs."""
    dense_cell: float = 0.0
    """Before training, match the training photos by optical flow and add a point where none is, about
    one every so many pixels (DPGS's initialisation). 0: none."""
    dssim: float = 0.2
    """Weight of 1 - SSIM; L1 has the rest."""
    antialiased: bool = False
    """Scale opacities by what the low-pass filter spreads a Gaussian over, in training and in every
    render of the model (the release's flag since 2024)."""
    random_background: bool = False
    """Train every step over a background of its own, drawn at random, so that nothing may stay
    transparent that a photo shows; the protocol's background is for scoring. False: train over the
    protocol's, as the release does by default."""
    dropout: float = 0.0
    """Share of Gaussians that a step hides at random, growing linearly from 0 to this; against
    floaters where few views see a place (DropGaussian: 0.2). 0: none."""
    opacity_weight: float = 0.0
    """Weight of the mean opacity in the loss, so that what no photo needs fades away (3DGS-MCMC:
    0.01). 0: none."""
    dense: DenseSettings = field(default_factory=DenseSettings)
    """Which photos are matched, and which matches become points, where `dense_cell` is not 0."""
    rates: Rates = field(default_factory=Rates)
    density: Density = field(default_factory=Density)

    @property
    def mode(self) -> Mode:
        """How the model is rasterized."""
        return "antialiased" if self.antialiased else "classic"

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(self.iterations >= 1, "iterations", self.iterations, ">= 1")
        require(self.views_per_step >= 1, "views_per_step", self.views_per_step, ">= 1")
        require(0 <= self.sh_degree <= 3, "sh_degree", self.sh_degree, "0 to 3")
        require(self.sh_interval >= 0, "sh_interval", self.sh_interval, ">= 0")
        opacity = self.initial_opacity
        require(0 < opacity < 1, "initial_opacity", opacity, "between 0 and 1")
        require(self.random_points >= 0, "random_points", self.random_points, ">= 0")
        require(0 <= self.dense_cell < math.inf, "dense_cell", self.dense_cell, ">= 0")
        require(0 <= self.dssim <= 1, "dssim", self.dssim, "0 to 1")
        require(0 <= self.dropout < 1, "dropout", self.dropout, "0 to below 1")
        require(0 <= self.opacity_weight < math.inf, "opacity_weight", self.opacity_weight, ">= 0")
