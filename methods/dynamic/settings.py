"""What can be chosen about sky and LiDAR, the same for every method of driving scenes."""

import math
from dataclasses import dataclass

from splatproof.methods.training.schedules import require


@dataclass(frozen=True, kw_only=True)
class SkySettings:
    """A sky infinitely far away, learnt, behind what is not opaque."""

    resolution: int = 64
    """Texels along an edge of each of the cube's six faces (the release of PVG: 1024, for images of 1920
    columns); 0: no sky."""
    initial: float = 0.5
    """SRGB of every texel at the start, 0 to 1 (the release: 0.5)."""
    rate: float = 0.01
    """Learning rate of the texels (the release: 0.01)."""
    covered: float = 1.0
    """Alpha, 0 to 1, from which a pixel teaches the sky nothing; 1: every pixel teaches it (both papers)."""
    weight: float = 0.05
    """Weight of the term that wants alpha 0 where masks show sky and 1 elsewhere (both papers: 0.05);
    0: masks are not read."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(self.resolution >= 0, "sky.resolution", self.resolution, ">= 0")
        for name in ("initial", "covered"):
            require(0 <= getattr(self, name) <= 1, f"sky.{name}", getattr(self, name), "0 to 1")
        for name in ("rate", "weight"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"sky.{name}", value, ">= 0")


@dataclass(frozen=True, kw_only=True)
class LidarSettings:
    """The term that pulls rendered depth to what the LiDAR measured."""

    weight: float = 0.1
    """Weight at the first step (PVG's release: 0.1; HDGS: 0.01); 0: no such term. What training starts from is
    chosen apart: start.sweep_points of pvg, from_sweeps of hdgs."""
    inverse: bool = True
    """Whether inverse depths are compared, as in PVG's release; False: depths, as in HDGS."""
    decay: float = 8000.0
    """Steps of a 30,000 step run after which the weight is 1/e of what it was (PVG's release: 8000); 0:
    it stays."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("weight", "decay"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"lidar.{name}", value, ">= 0")
