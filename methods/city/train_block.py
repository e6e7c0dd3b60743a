"""One block of a city: what it is trained from, and its training, resumable in any process."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Float, Int8
from torch import Tensor

from splatproof.base.files import write_text
from splatproof.base.memory import peak_memory_mb
from splatproof.base.tensor_files import read_tensors
from splatproof.methods.backends import get_backend
from splatproof.methods.city.point_roles import GHOST, OWN
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.methods.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import loop as training
from splatproof.methods.training.initialise import from_points
from splatproof.reference.partition.view_sampling import SamplingSettings, balanced_draws, view_bins
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

Report = Callable[[int, int, dict[str, float]], None]
"""report(step, total, values) of one block."""


@dataclass(frozen=True, kw_only=True)
class BlockFacts:
    """What one block was, and what it cost."""

    block: int
    views: int
    """Training views."""
    points: int
    """Sparse points that it owns."""
    load: int
    """Summed track length of the points it owns."""
    seconds: float = 0.0
    """Wall seconds of its training."""
    peak_mb: float = 0.0
    """Peak resident memory of the process that trained it, in 2^20 bytes."""
    primitives: int = 0
    """Gaussians when its training ended, ghosts left out."""
    kept: int = 0
    """Of those, what the merged model has."""
    note: str = ""
    """What was out of the ordinary; empty if nothing was."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockJob:
    """Everything that one block is trained from: its views and points and nothing else."""

    scene: Scene
    """The block's views, all for training, and the points it starts from."""
    roles: Int8[Tensor, " n"]
    """What becomes of each starting Gaussian: OWN, CONTEXT or GHOST."""
    settings: Settings
    facts: BlockFacts
    """Who it is; cost and primitives are filled in by training."""
    folder: Path
    """Its own: checkpoint and result."""
    centre: Float[Tensor, "3"]
    """Of the block, in the scene's frame."""
    frame: Float[Tensor, "3 3"]
    """Rotation into the ground frame."""
    sampling: SamplingSettings | None = None
    """Balanced sampling of views; None: uniform."""
    follow: bool = False
    """Let the ghosts' opacity and colour follow (dual mode); their geometry never does."""
    start: Path | None = None
    """File of a coarse model to start from; None: the scene's points."""
    seed: int = 0
    backend: str = "cpu"
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    checkpoint_seconds: float = 30.0
    image_bytes: int = 2**30

    @cached_property
    def key(self) -> str:
        """Hash of all that the trained block depends on: equal keys, equal blocks."""
        digest = hashlib.sha256(training.scene_digest(self.scene).encode())
        digest.update(self.roles.numpy().tobytes() + self.centre.numpy().tobytes())
        digest.update(self.frame.numpy().tobytes())
        if self.start is not None:
            digest.update(self.start.read_bytes())
        facts = [self.scene.name, asdict(self.settings), self.sampling and asdict(self.sampling),
                 self.follow, self.seed, self.backend, self.background]  # fmt: skip
        digest.update(json.dumps(facts).encode())
        return digest.hexdigest()

    @property
    def model(self) -> Path:
        """The folder of the trained block, see methods.models.explicit."""
        return self.folder / "model"

    @property
    def record(self) -> Path:
        """The file that says that the block is trained: key and facts."""
        return self.folder / "block.json"


def train_block(job: BlockJob, report: Report) -> BlockFacts:
    """Train one block to its model folder, or continue it; a block that is there is not repeated.

    Ghosts are left out of the model. A block without views or without points of its own has an
    empty model, and a note that says so.

    Args:
        job: What to train.
        report: Hears report(step, total, values).

    Returns: The job's facts with seconds, peak memory and primitives.

    Raises: UsageError if the folder holds a checkpoint of another block.
    """
    if (facts := trained(job)) is not None:
        return facts
    started = job.start and read_gaussians(job.start)
    rows = len(started) if started is not None else len(job.scene.points)
    if not job.scene.train or rows == 0 or not bool((job.roles == OWN).any()):
        missing = "no view trains it" if not job.scene.train else "no point to start from"
        empty = no_gaussians(job.settings.sh_degree)
        return _finish(job, empty, replace(job.facts, note=f"left empty: {missing}"))
    run = Run(
        folder=job.folder, seed=job.seed, backend=job.backend, background=job.background,
        report=report, checkpoint_seconds=job.checkpoint_seconds, image_bytes=job.image_bytes,
    )  # fmt: skip
    trainer = BlockTrainer(job, run, started)
    trainer.resume()
    trainer.train()
    model = select(trainer.gaussians(), trainer.roles != GHOST)
    note = job.facts.note if len(model) else "left empty: training pruned every Gaussian of its own"
    facts = replace(
        job.facts,
        seconds=trainer.seconds,
        peak_mb=peak_memory_mb(),
        primitives=len(model),
        note=note,
    )
    return _finish(job, model, facts)


def _finish(job: BlockJob, model: Gaussians, facts: BlockFacts) -> BlockFacts:
    """Save the model, then the record; the checkpoint has served."""
    ExplicitModel(
        model=model, method="block", settings=asdict(job.settings), shift=job.scene.shift,
        units=job.scene.units, backend=job.backend, mode=job.settings.mode,
    ).save(job.model)  # fmt: skip
    write_text(job.record, json.dumps({"key": job.key, "facts": asdict(facts)}) + "\n")
    (job.folder / "checkpoint" / "training.safetensors").unlink(missing_ok=True)
    return facts


def trained(job: BlockJob) -> BlockFacts | None:
    """Facts of a block that was trained before; None if there is none, or of another key."""
    if not job.record.exists():
        return None
    stored = json.loads(job.record.read_text(encoding="utf-8"))
    return BlockFacts(**stored["facts"]) if stored["key"] == job.key else None


def read_gaussians(path: Path) -> Gaussians:
    """The Gaussians that lie in a file of tensors."""
    tensors, _ = read_tensors(path)
    return Gaussians(**{name: tensors[name] for name in FIELDS})


def select(model: Gaussians, rows: Tensor) -> Gaussians:
    """Some Gaussians of a model: a mask or indices."""
    return Gaussians(**{name: getattr(model, name)[rows] for name in FIELDS})


def no_gaussians(degree: int) -> Gaussians:
    """A model of nothing."""
    return Gaussians(
        means=torch.zeros(0, 3), quaternions=torch.zeros(0, 4), log_scales=torch.zeros(0, 3),
        opacity_logits=torch.zeros(0), sh=torch.zeros(0, (degree + 1) ** 2, 3),
    )  # fmt: skip


class BlockTrainer(training.Trainer):
    """Training in which rows have roles: own, context (never densified), ghost (held still)."""

    def __init__(self, job: BlockJob, run: Run, start: Gaussians | None) -> None:
        """Start from the job's points or a coarse model."""
        settings = job.settings
        if start is None:
            start = from_points(
                job.scene, degree=settings.sh_degree, opacity=settings.initial_opacity
            )
        super().__init__(
            job.scene, settings, run, get_backend(job.backend), start=start, special=job.key
        )
        self.roles = job.roles.clone()
        if len(self.roles) != len(start):
            self.roles = torch.full((len(start),), OWN, dtype=torch.int8)
        self.still = ("means", "scales", "quaternions")
        if not job.follow:
            self.still += ("opacity", "sh_dc", "sh_rest")
        self.draws = None
        if job.sampling is not None:
            centres = torch.stack([view.camera.centre.double() for view in job.scene.train_views])
            bins = view_bins(centres, job.centre.double(), job.frame.double(), job.sampling)
            generator = torch.Generator().manual_seed(job.seed)
            self.draws = balanced_draws(bins, job.sampling, generator)

    def next_view(self) -> int:
        """Balanced over where the views stand, or as for any model."""
        return super().next_view() if self.draws is None else next(self.draws)

    def update(self) -> None:
        """Follow the gradients, but put the ghosts back to where they were."""
        ghost = (self.roles == GHOST).nonzero()[:, 0]
        held = {name: self.adam.parameters[name].detach()[ghost] for name in self.still}
        super().update()
        for name, values in held.items():
            self.adam.parameters[name].detach()[ghost] = values

    def densify(self, fixed: Tensor | None = None) -> Tensor:
        """Clone and split the block's own Gaussians; prune context too, ghosts never."""
        self.control.gradient_sum[self.roles != OWN] = -1  # below any threshold
        parents = super().densify(self.roles == GHOST)
        self.roles = self.roles[parents]
        return parents

    def reset(self) -> None:
        """Reset opacities, but not those of ghosts that are held."""
        before = self.adam.parameters["opacity"].detach().clone()
        super().reset()
        if "opacity" in self.still:
            held = self.roles == GHOST
            self.adam.parameters["opacity"].detach()[held] = before[held]

    def state(self) -> dict[str, Tensor]:
        """Each row's role."""
        return {"roles": self.roles}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take the roles over, and skip the views that were drawn before."""
        self.roles = state["roles"].clone()
        if self.draws is not None:
            for _ in range(self.step * self.settings.views_per_step):
                next(self.draws)
