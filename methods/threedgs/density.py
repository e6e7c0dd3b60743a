"""What can be chosen about the density control of method 3dgs: four strategies, and insertion."""

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from splatproof.methods.training.density import Density
from splatproof.methods.training.schedules import require

Strategy = Literal["gradient", "mcmc", "error", "spread"]


@dataclass(frozen=True, kw_only=True)
class Mcmc:
    """Density control of 3DGS-MCMC: dead Gaussians are moved onto living ones, all are shaken. What it adds to
    the loss beside the mean scale is the method's `opacity_weight` (its paper: 0.01)."""

    growth: float = 0.05
    """Share by which the number of Gaussians grows at each densification, up to `density.most`. A run of
    hundreds of steps has few densifications: `density.least_interval` gives it more."""
    noise: float = 5e5
    """Strength of the noise on positions after each step: a Gaussian of covariance Sigma moves by this times the
    positions' learning rate times Sigma xi, lengths in extents of the scene; opaque ones hardly do. 0: none."""
    scale_weight: float = 0.01
    """Weight of the mean scale, in extents of the scene, in the loss. 0: none."""
    spread: float = 0.0
    """How far from what it copies a Gaussian is put: drawn from the copy's own shape, so many times as large.
    Copies in one place are pulled alike, and opaque ones not shaken, so that short runs hardly part them. 0: in
    its place, as in the paper."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("growth", "noise", "scale_weight", "spread"):
            value = getattr(self, name)
            require(0 <= value < math.inf, f"density.mcmc.{name}", value, ">= 0")


@dataclass(frozen=True, kw_only=True)
class ErrorGate:
    """Growing by what several views agree on, after FastGS: of the Gaussians that are pulled at, only those
    that show on pixels with large errors are cloned or split."""

    threshold: float = 0.1
    """Share of the range of a view's errors, 0 to 1, above which a pixel counts."""
    pixels: float = 5.0
    """Such pixels that a Gaussian shows on, mean over the views and weighted by how much of each is its own, above
    which it may grow; pixels of the photos in full size."""
    blame: float = 1.0
    """Largest blame, 0 to 1, with which a Gaussian outlives a densification: those pixels weighted by the loss of
    each view, relative to the most blamed one (FastGS: 0.9, late in training). 1: none is removed for it."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name, most in (("threshold", 1.0), ("pixels", math.inf), ("blame", 1.0)):
            value = getattr(self, name)
            require(0 <= value <= most, f"density.error.{name}", value, f"0 to {most:g}")


@dataclass(frozen=True, kw_only=True)
class Insertion:
    """New Gaussians on pixels of photos with large errors, where a render says how far the surface is."""

    share: float = 0.0
    """Gaussians put in before each densification, as a share of those that are there, up to `density.most`. 0:
    none are."""
    size: float = 1.0
    """Scale of a new Gaussian, in pixels of the photo at its depth."""
    opacity: float = 0.1
    """Opacity of a new Gaussian, between 0 and 1."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(0 <= self.share < math.inf, "density.insertion.share", self.share, ">= 0")
        require(0 < self.size < math.inf, "density.insertion.size", self.size, "> 0")
        opacity = self.opacity
        require(0 < opacity < 1, "density.insertion.opacity", opacity, "between 0 and 1")


@dataclass(frozen=True, kw_only=True)
class StrategicDensity(Density):
    """Density control of method 3dgs: how, when and where Gaussians are added and removed (defaults of the
    3DGS release). Steps are those of a 30,000 step run; a shorter run shrinks them in proportion."""

    strategy: Strategy = "gradient"
    """How. gradient: what the loss pulls at is cloned and split; error: of it only what several views show
    errors of; mcmc: nothing is removed, what is transparent is moved; spread: as many
    as are pulled at, but drawn of all by how far pixels of several views disagree about their opacity (LiteGS)."""
    mcmc: Mcmc = field(default_factory=Mcmc)
    """What strategy mcmc does beside moving Gaussians."""
    error: ErrorGate = field(default_factory=ErrorGate)
    """What strategy error asks for."""
    insertion: Insertion = field(default_factory=Insertion)
    """New Gaussians at errors, beside strategy gradient or error."""
    scored_views: int = 10
    """Training views, drawn at each densification, whose errors are looked at; of fewer photos all."""

    @property
    def looks(self) -> bool:
        """Whether errors of views are looked at."""
        return self.strategy in ("error", "spread") or self.insertion.share > 0

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        require(self.scored_views >= 1, "density.scored_views", self.scored_views, ">= 1")

    def require_in_place(self) -> None:
        """Refuse settings that the strategy does not look at, and a strategy without what it needs."""
        strategy = self.strategy
        if strategy == "mcmc":
            self._require_unset("gradient", "split_gradient", "split_size", "largest_size", "pace")
            never = self.reset_interval in (0, Density.reset_interval)
            require(never, "density.reset_interval", self.reset_interval,
                    "0 under strategy mcmc, which resets no opacity")  # fmt: skip
            require(self.most is not None, "density.most", self.most,
                    "a number of Gaussians under strategy mcmc, which grows up to it")  # fmt: skip
            require(self.least_opacity > 0, "density.least_opacity", self.least_opacity,
                    "> 0 under strategy mcmc, which moves what is no more opaque")  # fmt: skip
            self._require_unset("insertion")
        else:
            self._require_unset("mcmc")
        if strategy == "spread":
            self._require_unset("split_gradient", "insertion")
        if strategy != "error":
            self._require_unset("error")
        if not self.looks:
            self._require_unset("scored_views")

    def _require_unset(self, *names: str) -> None:
        """Refuse values other than the usual ones of settings that nothing looks at."""
        usual: Any = StrategicDensity()
        for name in names:
            value, default = getattr(self, name), getattr(usual, name)
            for part, found in _leaves(name, value):
                wanted = dict(_leaves(name, default))[part]
                require(found == wanted, f"density.{part}", found,
                        f"{wanted}, its default: strategy {self.strategy} does not look at it"
                        )  # fmt: skip


def _leaves(name: str, value: Any) -> list[tuple[str, Any]]:
    """A setting, or the settings of a group, by their names."""
    if not isinstance(value, (Mcmc, ErrorGate, Insertion)):
        return [(name, value)]
    return [(f"{name}.{part.name}", getattr(value, part.name)) for part in fields(value)]
