"""Settings of the city rows: one set of fields, and each row's own defaults."""

from dataclasses import dataclass, field, fields
from typing import Literal

from splatproof.methods.city.partition import PartitionSettings
from splatproof.methods.city.point_roles import Auxiliary, Surrounding
from splatproof.methods.city.refine import RefineSettings
from splatproof.methods.storage.packed.writer import FileSettings
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.schedules import require
from splatproof.reference.partition.view_sampling import SamplingSettings
from splatproof.reference.stitching.stochastic import StitchSettings

GRID = PartitionSettings(method="citygaussian")
CAMERAS = PartitionSettings(method="vastgaussian")
DENSITY = PartitionSettings(method="blockgaussian")
DENSITY_WIDE = PartitionSettings(method="blockgaussian", margin=0.15, block_share=0.05)
"""StitchGS' release: expand_ratio 0.15, tau_block 0.05."""
LOAD = PartitionSettings(method="odbp", margin=0.0)
LOAD_WIDE = PartitionSettings(method="odbp", margin=0.15)


@dataclass(frozen=True, kw_only=True)
class CitySettings(Settings):
    """Blocks that are trained apart and merged. `iterations` are those of each block."""

    blocks: int = 4
    """K, the number of blocks."""
    partition: PartitionSettings = field(default_factory=PartitionSettings)
    """How the scene is cut."""
    coarse_iterations: int = 0
    """Steps of a coarse model of the whole scene that all blocks start from; 0: none."""
    auxiliary: Auxiliary = "none"
    """What takes part in a block beside its own points."""
    follow: bool = False
    """Let ghosts' opacity and colour follow; their geometry is held in any case."""
    surrounding: Surrounding = "box"
    """Where ghosts are taken from: the box around a block, or its own shape widened."""
    sampling: Literal["uniform", "balanced"] = "uniform"
    """How a block draws its views."""
    bins: SamplingSettings = field(default_factory=SamplingSettings)
    """Of balanced sampling."""
    merge: Literal["hard", "sis"] = "hard"
    """hard: every place is its own block's; sis: blocks compete for their rims at random."""
    outside: Literal["drop", "nearest"] = "drop"
    """hard: what becomes of what lies in no block."""
    stitch: StitchSettings = field(default_factory=StitchSettings)
    """Of the competition."""
    gcr: bool = False
    """Whether the merged model is cleaned and its appearance refined over all views."""
    refine: RefineSettings = field(default_factory=RefineSettings)
    """Of that refinement."""
    quantise: bool = False
    """Whether the model is stored gated, in mixed precision and compressed."""
    pack: FileSettings = field(default_factory=FileSettings)
    """Of that file."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        require(self.blocks >= 1, "blocks", self.blocks, ">= 1")
        require(self.coarse_iterations >= 0, "coarse_iterations", self.coarse_iterations, ">= 0")
        if self.coarse_iterations > 0:
            require(self.auxiliary == "none", "auxiliary", self.auxiliary,
                    "'none' with a coarse model: blocks start from all of it")  # fmt: skip
        require(0 <= self.bins.uniform_share <= 1, "bins.uniform_share", self.bins.uniform_share,
                "0 to 1")  # fmt: skip
        for name in ("azimuths", "distances"):
            value = getattr(self.bins, name)
            require(value >= 1, f"bins.{name}", value, ">= 1")
        require(self.stitch.neighbours >= 1, "stitch.neighbours", self.stitch.neighbours, ">= 1")
        sharpness = self.stitch.sharpness
        require(0 <= sharpness < float("inf"), "stitch.sharpness", sharpness, "finite and >= 0")
        require(self.pack.gate >= 0, "pack.gate", self.pack.gate, ">= 0")

    @property
    def training(self) -> Settings:
        """Those of each block's training."""
        names = [part.name for part in fields(Settings)]
        return Settings(**{name: getattr(self, name) for name in names})


@dataclass(frozen=True, kw_only=True)
class CityGaussian(CitySettings):
    """Row citygaussian: coarse model first, uniform grid in contracted space, hard merge."""

    partition: PartitionSettings = GRID
    coarse_iterations: int = 30_000


@dataclass(frozen=True, kw_only=True)
class VastGaussian(CitySettings):
    """Row vastgaussian: camera-balanced grid, visibility-based views, hard merge."""

    partition: PartitionSettings = CAMERAS


@dataclass(frozen=True, kw_only=True)
class BlockGaussian(CitySettings):
    """Row blockgaussian: density split, 5 % margin, context trained but not densified, hard merge."""

    partition: PartitionSettings = DENSITY
    auxiliary: Auxiliary = "context"


@dataclass(frozen=True, kw_only=True)
class DpgsPartition(CitySettings):
    """Row dpgs-partition: equal rendering load, frozen ghosts around each block, hard merge."""

    partition: PartitionSettings = LOAD
    auxiliary: Auxiliary = "ghosts"


@dataclass(frozen=True, kw_only=True)
class StitchGS(CitySettings):
    """Row stitchgs: density split with margin, balanced sampling, SIS, GCR, compression."""

    partition: PartitionSettings = DENSITY_WIDE
    auxiliary: Auxiliary = "context"
    sampling: Literal["uniform", "balanced"] = "balanced"
    merge: Literal["hard", "sis"] = "sis"
    gcr: bool = True
    quantise: bool = True


@dataclass(frozen=True, kw_only=True)
class OdbpStitch(CitySettings):
    """Row odbp+stitch: equal rendering load and ghosts; a trained margin, SIS, GCR, compression.

    Ghosts are held still, so they cannot compete for a rim: the rim is trained (margin), ghosts lie
    beyond it in the auxiliary box, and what views see beyond that is trained but not densified.
    """

    partition: PartitionSettings = LOAD_WIDE
    auxiliary: Auxiliary = "both"
    sampling: Literal["uniform", "balanced"] = "balanced"
    merge: Literal["hard", "sis"] = "sis"
    gcr: bool = True
    quantise: bool = True
