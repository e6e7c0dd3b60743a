"""What can be chosen about method stratosplat."""

import math
from dataclasses import dataclass, field
from typing import Literal

from splatproof.datasets.pose_noise import LEVELS
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.schedules import require
from splatproof.reference.types.result import TRUE_POSES

Start = Literal["sfm", "dense", "independent", "layered"]
Memory = Literal["ldi", "accumulate"]
Order = Literal["random", "distance", "coverage"]
Field = Literal["none", "table", "neural"]
Level = Literal["none", "L1", "L2", "L3"]
Stage = Literal["train", "completion", "all"]
Prior = Literal["scene", "own"]


@dataclass(frozen=True, kw_only=True)
class Completion:
    """How the depth of every training photo is completed before training."""

    memory: Memory = "ldi"
    """Where completed depths are kept: ldi merges what lies within `merge` of each other; accumulate keeps
    every sample (the paper: ldi)."""
    order: Order = "coverage"
    """Which photo comes first: the one with the most sparse points, the one nearest to the memory's
    reference camera, or one drawn at random (the paper: coverage)."""
    prior: Prior = "scene"
    """What a photo's depth is completed from besides its points: the scene's depth prior, where it has one (the
    case's `depth_prior` gives it one), or what our own network says, given the photo and its points, with weights
    that come along (the paper: a network of depth, Marigold)."""
    visible_weight: float = 0.1
    """Weight of the memory's depth beside that of the sparse points (the paper: 0.1)."""
    guidance_steps: int = 20
    """Steps of the guidance at each denoising step (the paper gives none)."""
    merge: float = 0.005
    """Depth within which samples of a pixel are merged, as a share of the distance from the memory's reference
    camera to the farthest sparse point, not of the range of depths, which over flat ground is nothing (ours; the
    paper: 0.02 and 0.55 scene units)."""
    side: int = 240
    """Pixels of the longer side at which photos are completed; larger ones are made smaller."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        weight = self.visible_weight
        require(0 <= weight < math.inf, "completion.visible_weight", weight, ">= 0")
        require(self.guidance_steps >= 0, "completion.guidance_steps", self.guidance_steps, ">= 0")
        require(0 < self.merge < 1, "completion.merge", self.merge, "between 0 and 1")
        require(self.side >= 8, "completion.side", self.side, ">= 8")


@dataclass(frozen=True, kw_only=True)
class Planes:
    """The virtual Gaussians: where they lie and what gives them colour and opacity."""

    field: Field = "neural"
    """neural: one smooth field over space; table: numbers of their own for each cell of each plane (the
    paper's fixed multi-plane Gaussians); none: no virtual Gaussians."""
    bias: bool = True
    """Whether far planes of a ray start more opaque than near ones."""
    count: int = 8
    """Number of planes K (the paper gives none)."""
    stride: int = 2
    """Side in pixels of the cell that a ray goes through (the paper: 1)."""
    finest: int = 64
    """Cells along each axis of the neural field's finest grid; three coarser grids halve them (the paper
    gives none). A table has twice as many along a plane."""
    rate: float = 0.01
    """Adam's rate for grids and tables; the network's is a fifth of it. Not tuned."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in ("count", "stride"):
            require(getattr(self, name) >= 1, f"planes.{name}", getattr(self, name), ">= 1")
        require(self.finest >= 16, "planes.finest", self.finest, ">= 16")
        require(0 <= self.rate < math.inf, "planes.rate", self.rate, ">= 0")


@dataclass(frozen=True, kw_only=True)
class StratoSplat(Settings):
    """Method stratosplat: 3dgs from completed depths, with virtual Gaussians on planes. Steps are those
    of a 30,000 iteration run; a shorter run shrinks them."""

    dense_cell: float = 4.0
    """About how many pixels points lie apart that are matched between photos before anything else, where
    `init` is not sfm; 0: none are. Depths are completed from them too: of few small photos structure from
    motion leaves too few (the paper's have thousands, and its completion network knows more than ours)."""
    init: Start = "layered"
    """What explicit Gaussians start from: sfm: the sparse points; dense: points matched between photos
    besides (DPGS's initialisation); independent: the depth of each photo completed by its own points and
    prior; layered: each also by the memory of those before it (the paper)."""
    noise: Level = "none"
    """Level of noise on the training poses, as the option --pose-noise has it, for a stage alone."""
    noise_stage: Stage = "all"
    """Which stage sees the noise: completion of depths with the matches before it (of init = "dense" the matches
    alone), training, or both."""
    completion: Completion = field(default_factory=Completion)
    """How depths are completed, where `init` is independent or layered; prior = "own" is refused elsewhere."""
    planes: Planes = field(default_factory=Planes)
    """Virtual Gaussians on parallel planes."""

    @property
    def completes(self) -> bool:
        """Whether depths are completed before training."""
        return self.init in ("independent", "layered")

    def noise_of(self, stage: Stage) -> str:
        """Level of the noise on the poses that a stage works with.

        Args:
            stage: train or completion.
        """
        return self.noise if self.noise_stage in (stage, "all") else TRUE_POSES

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        require(self.noise in LEVELS, "noise", self.noise, ", ".join(LEVELS))
        if self.init == "dense":
            require(self.dense_cell > 0, "dense_cell", self.dense_cell, "> 0 where init is dense")
        fine = self.noise == TRUE_POSES or self.noise_stage != "completion" or self.init != "sfm"
        require(fine, "noise_stage", self.noise_stage,
                "train or all where init is 'sfm', which makes nothing of the photos before training")  # fmt: skip
        own = self.completion.prior != "own" or self.completes
        require(own, "completion.prior", self.completion.prior,
                f"scene where init is {self.init!r}, which completes no depths")  # fmt: skip
