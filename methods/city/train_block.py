"""One block of a city: what it is trained from, and its training, resumable in any process."""

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import torch
from jaxtyping import Float, Int8
from torch import Tensor

from splatproof.base.files import read_bytes
from splatproof.base.memory import peak_memory_mb, peak_within
from splatproof.base.tensor_files import read_tensors
from splatproof.methods.city.block_facts import BlockFacts, read_facts, write_facts
from splatproof.methods.city.block_terms import NO_TERMS, BlockTerms, block_terms, with_appearance
from splatproof.methods.city.planted import NO_PLANT, PlantSettings
from splatproof.methods.city.point_roles import (
    GHOST,
    LEFT_OUT,
    OWN,
    ROLE,
    held_rows,
    role_rules,
)
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.refiners import Refiner, read_refiner
from splatproof.methods.dpgs.settings import NO_SIDES, SideSettings
from splatproof.methods.dpgs.side_training import with_side_views
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.methods.models.exposure import exposed
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.threedgs.fit import terms
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density_control import DensityControl
from splatproof.methods.training.initialise import extent, from_points
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import restarts, shrink
from splatproof.methods.training.session import run_key, scene_digest
from splatproof.methods.training.view_order import Drawn, ViewOrder
from splatproof.reference.partition.view_sampling import (
    SamplingSettings,
    balanced_draws,
    view_bins,
)
from splatproof.reference.supervision.side_views import is_side_view_step
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

Report = Callable[[int, int, dict[str, float]], None]
"""report(step, total, values) of one block."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockJob:
    """Everything that one block is trained from: its views and points and nothing else."""

    scene: Scene
    """The block's views, all for training, and the points it starts from."""
    roles: Int8[Tensor, " n"]
    """What becomes of each starting Gaussian: OWN, CONTEXT or GHOST; of a coarse model's also LEFT_OUT."""
    settings: Settings
    facts: BlockFacts
    """Which block it is; training fills in cost and primitives."""
    folder: Path
    """Folder of this block alone: checkpoint and result."""
    centre: Float[Tensor, "3"]
    """Centre of the block's region; in the scene's frame but for a ContractedRegion."""
    frame: Float[Tensor, "3 3"]
    """Rotation from the scene into the ground frame."""
    sampling: SamplingSettings | None = None
    """Bins of balanced sampling of views; None: uniform sampling."""
    follow: bool = False
    """Whether opacity and colour of ghosts are trained (dual mode); their geometry never is."""
    start: Path | None = None
    """File of a coarse model to start from; None: the scene's points."""
    sides: tuple[Camera, ...] = ()
    """Where side views of the block are taken from."""
    side: SideSettings = NO_SIDES
    """How often side views come, and who refines them."""
    weights: str = ""
    """Hash of that refiner's weights; empty where it has none."""
    block_terms: BlockTerms = NO_TERMS
    """What is minimised beside the photos."""
    planted: PlantSettings = NO_PLANT
    """What was made wrong about the photos of the scene's views."""
    seed: int = 0
    backend: str = "cpu"
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    checkpoint_seconds: float = 30.0
    image_bytes: int = 2**30

    @cached_property
    def key(self) -> str:
        """Hash of all that the trained block depends on: equal keys, equal blocks."""
        digest = hashlib.sha256(scene_digest(self.scene).encode())
        digest.update(self.roles.numpy().tobytes() + self.centre.numpy().tobytes())
        digest.update(self.frame.numpy().tobytes())
        if self.start is not None:
            digest.update(read_bytes(self.start))
        facts = [self.scene.name, asdict(self.settings), self.sampling and asdict(self.sampling),
                 self.follow, self.seed, self.backend, self.background]  # fmt: skip
        if self.sides:  # else keys are those of before there were any
            poses = [one.world_to_camera.tolist() for one in self.sides]
            facts += [asdict(self.side), poses, *([self.weights] if self.weights else [])]
        if self.block_terms != NO_TERMS:
            facts += [asdict(self.block_terms), self.scene.facts.get("depth_prior_sha256", "")]
        if self.planted != NO_PLANT:
            facts.append(asdict(self.planted))
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

    def done(self) -> BlockFacts | None:
        """Facts of the block if it was trained before; None if it was not, or lies under another key."""
        return read_facts(self.record, self.key)

    def work(self, report: Report) -> BlockFacts:
        """Train it, see `train_block`.

        Args:
            report: Called as report(step, total, values) every few steps.
        """
        return train_block(self, report)


def train_block(job: BlockJob, report: Report) -> BlockFacts:
    """Train one block to its model folder, or continue it; a block that is there is not repeated.

    Ghosts are left out of the model. A block without views or without points of its own has an
    empty model, and a note that says so.

    Args:
        job: What to train, and where.
        report: Called as report(step, total, values) every few steps.

    Returns: The job's facts with seconds, processor seconds, peak memory and primitives.

    Raises: UsageError if the folder holds a checkpoint of another block.
    """
    if (facts := job.done()) is not None:
        return facts
    if not job.scene.train or not bool((job.roles == OWN).any()):
        missing = "no view trains it" if not job.scene.train else "no point to start from"
        empty = no_gaussians(job.settings.sh_degree)
        return _finish(job, empty, replace(job.facts, note=f"left empty: {missing}"))
    told: dict[str, str] = {}
    run = Run(
        folder=job.folder, seed=job.seed, backend=job.backend, background=job.background,
        report=report, on_fact=told.__setitem__, checkpoint_seconds=job.checkpoint_seconds, image_bytes=job.image_bytes,
    )  # fmt: skip
    peak: dict[str, float] = {}
    with peak_within(peak, "mb"):
        block, trainer, first = _trained(job, run)
    model = select(block.gaussians(), (block.parameters.labels[ROLE] != GHOST).cpu())
    note = job.facts.note if len(model) else "left empty: training pruned every Gaussian of its own"
    facts = replace(
        job.facts,
        seconds=trainer.seconds,
        cpu_seconds=trainer.cpu_seconds,
        peak_mb=peak.get("mb", peak_memory_mb()),
        gaussians=(first + len(block.parameters)) / 2,
        primitives=len(model),
        densifications=trainer.counts.densifications,
        note=note,
        told=told,
    )
    return _finish(job, model, facts)


def _trained(job: BlockJob, run: Run) -> tuple[GaussianModel, Trainer, int]:
    """The block at its end, who has trained it, and how many Gaussians it started with."""
    started = None if job.start is None else read_gaussians(job.start)
    block, plan = prepare(job, started, run)
    first = len(block.parameters)
    alone = len(plan.views) < 2  # one photo has nothing to be compared with
    shown = exposed(block, "off" if alone else job.settings.exposure, plan.views)
    if job.block_terms.appearance and not alone:
        shown, plan = with_appearance(shown, plan, job.seed)
    refiner = Refiner(refine=read_refiner(job.side) if job.sides else None, weights=job.weights)
    plan = with_side_views(job.sides, job.scene, shown, plan, job.side, refiner, run)
    trainer = Trainer(shown, plan, run)
    trainer.resume()
    trainer.train()
    return block, trainer, first


def _finish(job: BlockJob, model: Gaussians, facts: BlockFacts) -> BlockFacts:
    """Save the model, then the record; the checkpoint has served."""
    trained = ExplicitModel(
        model=model, shift=job.scene.shift, units=job.scene.units, backend=job.backend,
        mode=job.settings.mode,
    )  # fmt: skip
    origin = Origin(
        method="block", settings=asdict(job.settings), scene=job.scene.name, seed=job.seed
    )
    save_model(trained, job.model, origin)
    write_facts(job.record, job.key, facts)
    (job.folder / "checkpoint" / "training.safetensors").unlink(missing_ok=True)
    shutil.rmtree(job.folder / "checkpoint" / "side", ignore_errors=True)
    return facts


def read_gaussians(path: Path) -> Gaussians:
    """The Gaussians that lie in a file of tensors."""
    tensors, _ = read_tensors(path)
    return Gaussians(**{name: tensors[name] for name in FIELDS})


def select(model: Gaussians, rows: Tensor) -> Gaussians:
    """Some Gaussians of a model.

    Args:
        model: Any Gaussians.
        rows: Mask or indices.
    """
    return Gaussians(**{name: getattr(model, name)[rows] for name in FIELDS})


def no_gaussians(degree: int) -> Gaussians:
    """A model without Gaussians.

    Args:
        degree: Degree of its spherical harmonics, 0 to 3.
    """
    return Gaussians(
        means=torch.zeros(0, 3), quaternions=torch.zeros(0, 4), log_scales=torch.zeros(0, 3),
        opacity_logits=torch.zeros(0), sh=torch.zeros(0, (degree + 1) ** 2, 3),
    )  # fmt: skip


def prepare(job: BlockJob, start: Gaussians | None, run: Run) -> tuple[GaussianModel, Plan]:
    """The block's model at its start, with the roles of its rows as labels, and its plan.

    Args:
        job: What to train.
        start: Gaussians of the coarse model that the roles are of, with all bands of view-dependent
            colour in use from the first step on; None: the job's points.
        run: Seed, background, backend and device are part of the plan's key.
    """
    settings, scene = job.settings, job.scene
    sh_every = settings.sh_interval * shrink(settings.round_steps) if start is None else 0.0
    if start is None:
        start = from_points(scene, degree=settings.sh_degree, opacity=settings.initial_opacity)
    start, roles = select(start, job.roles != LEFT_OUT), job.roles[job.roles != LEFT_OUT]
    size = extent(scene)
    model = GaussianModel(
        start, settings.rates, extent=size, mode=settings.mode,
        sh_every=sh_every, dropout=settings.dropout,
        labels={ROLE: roles},
    )  # fmt: skip
    density = DensityControl(
        settings.density, iterations=settings.round_steps, extent=size,
        rules=role_rules(follow=job.follow),
    )  # fmt: skip
    return model, Plan(
        steps=settings.iterations,
        views=scene.train_views,
        terms=(*terms(settings), *block_terms(job.block_terms, run, size)),
        density=density,
        key=run_key(scene, settings, run, job.key),
        restarts=restarts(settings.iterations, settings.rounds),
        views_per_step=settings.views_per_step,
        random_background=settings.random_background,
        shapes=settings.shapes,
        order=_balanced(job),
        held=partial(held_rows, follow=job.follow),
    )


def least_visits(job: BlockJob) -> int:
    """How often training visits the photo of a block that it visits least, 0 where it has none.

    Exact without having watched: photos come in epochs, between side views, or by balanced draws, which are made again.

    Args:
        job: What is trained.
    """
    photos, steps = len(job.scene.train), job.settings.iterations
    drawn = steps * job.settings.views_per_step
    if not photos:
        return 0
    if (order := _balanced(job)) is None:
        aside = range(steps) if job.sides else ()
        drawn -= sum(is_side_view_step(step, steps, job.side.every) for step in aside)
        return drawn // photos
    unused = torch.Generator()
    visits = torch.tensor([order.next(unused) for _ in range(drawn)], dtype=torch.int64)
    return int(visits.bincount(minlength=photos).min())


def _balanced(job: BlockJob) -> ViewOrder | None:
    """Views balanced over where they stand, or None: shuffled as for any model."""
    if job.sampling is None:
        return None
    centres = torch.stack([view.camera.centre.double() for view in job.scene.train_views])
    bins = view_bins(centres, job.centre.double(), job.frame.double(), job.sampling)
    generator = torch.Generator().manual_seed(job.seed)
    return Drawn(balanced_draws(bins, job.sampling, generator))
