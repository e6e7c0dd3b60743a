"""Settings of the city methods: one set of fields, and each method's own defaults."""

from dataclasses import dataclass, field, fields
from typing import Literal

from splatproof.methods.city.block_terms import NO_TERMS, BlockTerms
from splatproof.methods.city.jobs import Even
from splatproof.methods.city.partition import PartitionSettings
from splatproof.methods.city.planted import NO_PLANT, PlantSettings
from splatproof.methods.city.point_roles import Auxiliary, Surrounding
from splatproof.methods.city.refine import RefineSettings
from splatproof.methods.dpgs.settings import NO_SIDES, SideSettings
from splatproof.methods.models.exposure import Exposure
from splatproof.methods.storage.packed.coded_writer import CodeSettings
from splatproof.methods.storage.packed.writer import FileSettings
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.schedules import require
from splatproof.reference.partition.view_sampling import SamplingSettings
from splatproof.reference.stitching.stochastic import StitchSettings

Coder = Literal["paper", "small"]
"""What writes the small file, see `CitySettings.coder`."""
Merge = Literal["hard", "sis", "shares", "fade"]
"""How blocks become one model, see `CitySettings.merge`."""
GRID = PartitionSettings(method="citygaussian")
CAMERAS = PartitionSettings(method="vastgaussian")
DENSITY = PartitionSettings(method="blockgaussian")
DENSITY_WIDE = PartitionSettings(method="blockgaussian", margin=0.15, block_share=0.05)
"""Margin and share of StitchGS' release: expand_ratio 0.15, tau_block 0.05."""
LOAD = PartitionSettings(method="odbp", margin=0.0)
LOAD_WIDE = PartitionSettings(method="odbp", margin=0.15)


@dataclass(frozen=True, kw_only=True)
class CitySettings(Settings):
    """A scene in blocks that are trained apart and merged. `iterations` are those of each block."""

    exposure: Exposure = "off"
    """What the coarse model, each block and the refinement learn of each photo beside the scene, each
    anew and zero on average over its photos; a block of one photo nothing. off: nothing; gain: exposure
    and white balance, as three gains; affine: a 3 x 4 map of its colours. The merged model is stored in
    neutral exposure."""
    blocks: int = 4
    """Number of blocks (K) that the scene is cut into; 1: the whole scene is one block."""
    partition: PartitionSettings = field(default_factory=PartitionSettings)
    """How the scene is cut into blocks, and which views train each of them."""
    coarse_iterations: int = 0
    """Training steps of a coarse model of the whole scene from which every block starts (method
    citygaussian: 30,000): its own are those of the coarse Gaussians that lie in its region, widened by
    `partition.margin`; `auxiliary` says what becomes of the others. 0: there is none, and blocks start
    from sparse points."""
    even: Even = "steps"
    """What all blocks have equally many of. steps: `iterations` training steps each; visits: steps for
    each of its training views, `iterations` steps on average."""
    auxiliary: Auxiliary = "none"
    """What takes part in a block beside its own points. none: nothing; context: what else its views
    see, trained but not densified (BlockGaussian); ghosts: what other blocks own around it,
    with positions, scales and rotations held still (DPGS), and with a coarse model all that its views
    show; both: context, and ghosts where there is none. With a coarse model and none every block
    starts from all of it."""
    follow: bool = True
    """Whether opacity and colour of ghosts are trained with the block that they surround; their
    positions, scales and rotations are held still in any case. False: only with a coarse model, which
    knows what they look like."""
    surrounding: Surrounding = "box"
    """Where ghosts are taken from, without a coarse model. box: the box around what a block owns, a
    fifth longer (DPGS, Eq. 7); region: the block's own shape, widened as far."""
    sampling: Literal["uniform", "balanced"] = "uniform"
    """How a block draws its training views. uniform: each once in every epoch; balanced: evenly
    over where the cameras stand around the block (StitchGS)."""
    bins: SamplingSettings = field(default_factory=SamplingSettings)
    """Which bins balanced sampling sorts cameras into."""
    side: SideSettings = NO_SIDES
    """Side views of each block, on spirals around its own points, in the second half of its training (DPGS);
    every = 0: none. With uniform sampling only."""
    block_terms: BlockTerms = NO_TERMS
    """What each block minimises beside its photos or in their place: depth, views from beside, volume (BlockGaussian,
    StitchGS), colours in each photo's appearance (VastGaussian)."""
    planted: PlantSettings = NO_PLANT
    """What is made wrong about each block's photos, so that there is a seam to be seen and mended: for trials of
    metrics and merges only."""
    merge: Merge = "hard"
    """How blocks become one model. hard: each keeps what lies within its own bounds; sis: beyond
    them blocks compete for a rim at random (stochastic interwoven stitching, StitchGS). Ours, for a
    strip on both sides of a wall in which blocks have shares that sum to 1: shares: a Gaussian stays
    with the probability of its share; fade: it keeps that share of its optical depth."""
    overlap: float = 0.0
    """Share of its size, 0 to 1, by which each block's core reaches beyond its bounds when blocks are merged. 0: cores
    abut; StitchGS' storage grows in its merge as if its cores overlapped, and 0.15 is the margin that its release trains.
    hard and sis keep all that lies in a core, whole, as the paper does: where cores overlap optical depth adds up.
    shares and fade have shares there too, which sum to 1."""
    outside: Literal["drop", "nearest"] = "drop"
    """What a hard merge does with Gaussians that lie in no block. drop: removes them, as the papers
    do; nearest: keeps those to which their own block is the nearest."""
    stitch: StitchSettings = field(default_factory=StitchSettings)
    """How blocks compete for a rim where `merge` is sis."""
    gcr: bool = False
    """Whether the merged model is cleaned and its opacities and colours are then fitted over all
    training views (global consistency refinement, StitchGS)."""
    refine: RefineSettings = field(default_factory=RefineSettings)
    """How the merged model is cleaned and refined where `gcr` is on."""
    quantise: bool = False
    """Whether the model is stored as a small file: view-dependent colour of little energy dropped
    and the rest of it in 8 bits, positions in single and all else in half precision, compressed."""
    coder: Coder = "paper"
    """What writes that file. paper: as `quantise` says, by `pack`; small: ours, all parts in steps of
    `code`, entropy-coded, as `bench export --packed` does; nothing is dropped, and the refinement sees
    view-dependent colour on those steps."""
    pack: FileSettings = field(default_factory=FileSettings)
    """What the paper's file keeps and how it is laid out."""
    code: CodeSettings = field(default_factory=CodeSettings)
    """How fine the steps of our file are."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        require(self.blocks >= 1, "blocks", self.blocks, ">= 1")
        require(
            self.resolution.coarsest == 1,
            "resolution.coarsest",
            self.resolution.coarsest,
            "1: blocks see photos in full size",
        )
        require(self.coarse_iterations >= 0, "coarse_iterations", self.coarse_iterations, ">= 0")
        guessed = self.auxiliary in ("ghosts", "both") and not self.coarse_iterations
        require(self.follow or not guessed, "follow", self.follow, "True with ghosts of sparse points, whose "
                "opacity is a guess: let them follow, or give them values by coarse_iterations")  # fmt: skip
        require(0 <= self.bins.uniform_share <= 1, "bins.uniform_share", self.bins.uniform_share,
                "0 to 1")  # fmt: skip
        mixed = bool(self.side.every) and self.sampling != "uniform"
        require(not mixed, "sampling", self.sampling, "'uniform' with side views")
        twice = self.block_terms.appearance and self.exposure != "off"
        require(not twice, "exposure", self.exposure, "'off' with block_terms.appearance")
        for name in ("azimuths", "distances"):
            value = getattr(self.bins, name)
            require(value >= 1, f"bins.{name}", value, ">= 1")
        require(self.stitch.neighbours >= 1, "stitch.neighbours", self.stitch.neighbours, ">= 1")
        sharpness = self.stitch.sharpness
        require(0 <= sharpness < float("inf"), "stitch.sharpness", sharpness, "finite and >= 0")
        require(0 <= self.overlap <= 1, "overlap", self.overlap, "0 to 1")
        require(self.pack.gate >= 0, "pack.gate", self.pack.gate, ">= 0")

    @property
    def training(self) -> Settings:
        """The part of these settings that the training of each block follows."""
        names = [part.name for part in fields(Settings)]
        return Settings(**{name: getattr(self, name) for name in names})


@dataclass(frozen=True, kw_only=True)
class CityGaussian(CitySettings):
    """Method citygaussian: coarse model first, uniform grid in contracted space, hard merge."""

    partition: PartitionSettings = GRID
    coarse_iterations: int = 30_000


@dataclass(frozen=True, kw_only=True)
class VastGaussian(CitySettings):
    """Method vastgaussian: camera-balanced grid, visibility-based views, hard merge."""

    partition: PartitionSettings = CAMERAS


@dataclass(frozen=True, kw_only=True)
class BlockGaussian(CitySettings):
    """Method blockgaussian: density split, 5 % margin, context not densified, hard merge."""

    partition: PartitionSettings = DENSITY
    auxiliary: Auxiliary = "context"


@dataclass(frozen=True, kw_only=True)
class DpgsPartition(CitySettings):
    """Method dpgs-partition: equal rendering load, frozen ghosts around each block, hard merge."""

    partition: PartitionSettings = LOAD
    auxiliary: Auxiliary = "ghosts"


@dataclass(frozen=True, kw_only=True)
class StitchGS(CitySettings):
    """Method stitchgs: density split with margin, balanced sampling, SIS, GCR, compression."""

    partition: PartitionSettings = DENSITY_WIDE
    auxiliary: Auxiliary = "context"
    sampling: Literal["uniform", "balanced"] = "balanced"
    merge: Merge = "sis"
    gcr: bool = True
    quantise: bool = True


@dataclass(frozen=True, kw_only=True)
class OdbpStitch(CitySettings):
    """Method odbp+stitch: equal rendering load and ghosts; a trained margin, SIS, GCR, compression.

    Ghosts do not move, so they cannot compete for a rim: the rim is trained (margin), what views see
    beyond it is trained but not densified, and the rest of the auxiliary box is ghosts.
    """

    partition: PartitionSettings = LOAD_WIDE
    auxiliary: Auxiliary = "both"
    sampling: Literal["uniform", "balanced"] = "balanced"
    merge: Merge = "sis"
    gcr: bool = True
    quantise: bool = True
