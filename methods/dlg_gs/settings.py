"""What can be chosen about method dlg-gs; the paper's ablations among it."""

import math
from dataclasses import dataclass, field
from typing import Literal

from splatproof.methods.scaffold import settings as scaffold
from splatproof.methods.training.schedules import require
from splatproof.reference.supervision.depth_constraint import Depth

Vdjc = Literal["off", "ec", "mc", "both"]
Dlaam = Literal["off", "gates", "full"]
Factor = Literal["hvi", "rgb", "learnt"]


@dataclass(frozen=True, kw_only=True)
class Rates(scaffold.Rates):
    """Those of scaffold-gs, and of what dlg-gs adds; log-linear from first to last step."""

    light: float = 8e-3
    """Rate at the first step of all that lighting adds, factor, gates, attention and colour head: that of
    the colour network (the paper gives none)."""
    light_final: float = 5e-5
    """The same at the last step."""
    centres: float = 1.6e-4
    """Rate of anchors' centres at the first step, in extents of the scene, where `vdjc` has the
    anchors' term, which would have no effect otherwise (the paper gives none; 3DGS's of positions)."""
    centres_final: float = 1.6e-6
    """The same at the last step."""


@dataclass(frozen=True, kw_only=True)
class Settings(scaffold.Settings):
    """Method dlg-gs: scaffold-gs with lighting-adaptive colours and depth constraints."""

    vdjc: Vdjc = "both"
    """Voxel-depth joint constraint: "ec" on the Gaussians' depth, "mc" on the anchors', "both" or
    "off". All but "off" need a depth prior of every training view."""
    ec: float = 0.01
    """Weight of the Gaussians' depth term."""
    mc: float = 0.01
    """Weight of the anchors' depth term."""
    depth_final: float = 1.0
    """Share of their weights that both depth terms still have at the last step, reached log-linearly from
    the first on, in (0, 1]; 1: constant, as in the paper. An error that true geometry has as well, by a
    wrong prior or by distances (`depth`), pulls at surfaces for as long as it counts (the 3DGS release
    ends its depth term at 0.01 of its weight)."""
    depth: Depth = "distance"
    """What both depth terms blend the inverse of: "distance" to the camera's centre, as the paper prints
    it; or "z" along the optical axis, as depth priors have it: true geometry has an error against true
    depth under the first alone, which clouds surfaces in long runs (docs/tunnel.md)."""
    weight_map: bool = True
    """Whether depth counts less where the adapted render differs from the original one."""
    dlaam: Dlaam = "full"
    """Lighting-adaptive colours: "full"; "gates", where an anchor sees none but itself; "off"."""
    factor: Factor = "hvi"
    """What tells a view's light: statistics of its photo in HVI or in RGB, or an embedding of each
    training view that is learnt."""
    factor_width: int = 8
    """Numbers of a view's adjustment factor (the paper gives none)."""
    radius: float = 2.0
    """How far an anchor sees others, in cells of the coarsest level of growing, which are as wide as
    points are apart (the paper gives none)."""
    head: int = 32
    """Width of the hidden layers of the colour head."""
    dropout: float = 0.1
    """Weight of the difference between the render without randomly chosen Gaussians and the full
    one; 0: off."""
    dropout_share: float = 0.1
    """Chance of each Gaussian to be left out of that render (the paper gives none)."""
    volume: float = 0.001
    """Weight of the volume term."""
    volume_rule: Literal["sum", "mean"] = "mean"
    """Volume of the decoded Gaussians of a view: their sum, as the paper prints it, which grows with
    the unit of length and with their number; or their mean, as the release that it builds on has it."""
    rates: Rates = field(default_factory=Rates)

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        for name in ("ec", "mc", "radius", "dropout"):
            require(0 <= getattr(self, name) < math.inf, name, getattr(self, name), ">= 0")
        for name in ("factor_width", "head"):
            require(getattr(self, name) >= 1, name, getattr(self, name), ">= 1")
        require(0 < self.depth_final <= 1, "depth_final", self.depth_final, "(0, 1]")
        require(0 <= self.dropout_share < 1, "dropout_share", self.dropout_share, "[0, 1)")

    @property
    def moves(self) -> bool:
        """Whether anchors move."""
        return self.vdjc in ("mc", "both")
