"""What can be chosen about method 3dgs."""

import math
from dataclasses import dataclass, field

from splatproof.methods.models.exposure import Exposure
from splatproof.methods.threedgs.density import StrategicDensity
from splatproof.methods.training.density import Density
from splatproof.methods.training.resolution import Resolution
from splatproof.methods.training.schedules import Rates, require, require_cell
from splatproof.methods.training.shape_bounds import Shapes
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.supervision.dense_initialisation import DenseSettings


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What method 3dgs and its relatives share. Steps are those of a 30,000 step run; a shorter run shrinks them
    in proportion."""

    iterations: int = 30_000
    """Number of training steps, each on `views_per_step` views (the paper: 30,000, and 7,000). In
    shorter runs the release's density control, squeezed, adds more Gaussians than few photos bear: suite
    brighton has settings for 2,000 steps."""
    rounds: int = 1
    """Number of trainings that follow each other in these steps, each as long, from what the one before has made: learning
    rates and density control begin again, and moments are forgotten. Gaussians that come in a second round come
    where the first has left errors; they cost time, and pay where photos are looked at often (docs/city.md). The
    release: 1."""
    views_per_step: int = 1
    """Number of views whose mean gradient one step follows (the release: 1)."""
    sh_degree: int = 3
    """Degree of the spherical harmonics of view-dependent colour, 0 (none) to 3 (the paper: 3)."""
    sh_interval: int = 1000
    """Steps after which each further SH degree is trained (the release: 1000); 0: all from the
    start."""
    initial_opacity: float = 0.1
    """Opacity, 0 to 1, of the Gaussians that sparse points become (the release: 0.1)."""
    random_points: int = 0
    """Number of points that a scene without any starts from, drawn in sight of its cameras (gsplat:
    100,000); 0: such a scene is refused. Scenes with points keep theirs."""
    dense_cell: float = 0.0
    """About how many pixels added points lie apart: before training, photos are matched (by whom
    says dense.matcher), and points added where there are none (DPGS's initialisation). 0: none are
    added."""
    most_points: int | None = None
    """Most points that training starts from: where there are more, those of one voxel become one. None:
    no bound."""
    dssim: float = 0.2
    """Weight of 1 - SSIM in the loss, 0 to 1; L1 has the rest (the paper: 0.2)."""
    antialiased: bool = False
    """Whether opacities are lowered by as much as the low-pass filter widens a Gaussian, in
    training and in every render of the model (the release's flag `antialiasing`, since 2024)."""
    resolution: Resolution = field(default_factory=Resolution)
    """How large photos are as training goes on."""
    random_background: bool = False
    """Whether every view of a step is trained over a colour drawn at random, so that nothing may
    stay transparent that a photo shows; scoring uses the protocol's background. False: training
    too, as the release does by default."""
    dropout: float = 0.0
    """Share of Gaussians, 0 to below 1, that a step hides at random, growing linearly from 0 to
    this at the last step: against floaters where few views see a place (DropGaussian: 0.2). 0:
    none."""
    opacity_weight: float = 0.0
    """Weight of the mean opacity in the loss, so that what no photo needs fades away (3DGS-MCMC:
    0.01). 0: none."""
    widest: float = 0.0
    """Largest scale of a Gaussian as a share of its distance to the nearest training camera, looked at every 50
    steps: a wider one is drawn wrongly from beside it and can veil a photo that nobody trained on. 0: no
    bound (the release)."""
    widest_at_points: float = 0.0
    """The same for a Gaussian on a point that training starts from; one further away may be as wide as it is far from
    the nearest of them, up to `widest`. Against faint wide Gaussians over what is known in detail. 0: as elsewhere."""
    thickest: float = 0.0
    """Largest extent of a Gaussian along the ray to the nearest training camera, as a share of its distance to it,
    looked at every 50 steps: a thicker one is flattened along that ray, which that camera does not see, and who looks
    from beside sees less fog. 0: no bound (the release)."""
    exposure: Exposure = "off"
    """What is learnt of each photo beside the scene, zero on average over the photos: off: nothing;
    gain: exposure and white balance, as three gains; affine: a 3 x 4 map of its colours."""
    dense: DenseSettings = field(default_factory=DenseSettings)
    """Which photos are matched, and which matches become points, where `dense_cell` is not 0."""
    rates: Rates = field(default_factory=Rates)
    """Learning rates of the Gaussians' parameters."""
    density: Density = field(default_factory=Density)
    """When and where Gaussians are added and removed."""

    @property
    def shapes(self) -> Shapes:
        """Which shapes Gaussians may have."""
        return Shapes(
            widest=self.widest, widest_at_points=self.widest_at_points, thickest=self.thickest
        )

    @property
    def round_steps(self) -> int:
        """Steps of a round; the last one may have fewer."""
        return -(-self.iterations // self.rounds)

    @property
    def mode(self) -> Mode:
        """How the model is rasterized."""
        return "antialiased" if self.antialiased else "classic"

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(self.iterations >= 1, "iterations", self.iterations, ">= 1")
        require(self.rounds >= 1, "rounds", self.rounds, ">= 1")
        require(self.views_per_step >= 1, "views_per_step", self.views_per_step, ">= 1")
        require(0 <= self.sh_degree <= 3, "sh_degree", self.sh_degree, "0 to 3")
        require(self.sh_interval >= 0, "sh_interval", self.sh_interval, ">= 0")
        opacity = self.initial_opacity
        require(0 < opacity < 1, "initial_opacity", opacity, "between 0 and 1")
        require(self.random_points >= 0, "random_points", self.random_points, ">= 0")
        require_cell(self.dense_cell)
        fine = self.most_points is None or self.most_points >= 1
        require(fine, "most_points", self.most_points, ">= 1 or None")
        require(0 <= self.dssim <= 1, "dssim", self.dssim, "0 to 1")
        require(0 <= self.dropout < 1, "dropout", self.dropout, "0 to below 1")
        require(0 <= self.opacity_weight < math.inf, "opacity_weight", self.opacity_weight, ">= 0")
        for name in ("widest", "widest_at_points", "thickest"):
            value = getattr(self, name)
            require(0 <= value < math.inf, name, value, "0 (no bound) or more")


@dataclass(frozen=True, kw_only=True)
class ThreeDGS(Settings):
    """Method 3dgs. Steps are those of a 30,000 step run; a shorter run shrinks them in
    proportion."""

    density: StrategicDensity = field(default_factory=StrategicDensity)
    """How, when and where Gaussians are added and removed."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        self.density.require_in_place()
        alone = not self.density.looks or self.rounds == 1
        require(alone, "rounds", self.rounds, "1 where density control looks at errors of views")
        seen = not self.density.looks or self.exposure == "off"
        require(seen, "exposure", self.exposure, "off where density control looks at errors of views, which "
                "it renders without exposures")  # fmt: skip
