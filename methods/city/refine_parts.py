"""The refinement in parts: what each block owns is fitted to the block's own views, wherever blocks are trained."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatproof.base.files import read_bytes
from splatproof.base.memory import peak_memory_mb, peak_within
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.city.block_facts import BlockFacts, read_facts, write_facts
from splatproof.methods.city.coarse import shown_by
from splatproof.methods.city.executor import BlocksReport, run_blocks
from splatproof.methods.city.jobs import SEEDS_APART, block_scene
from splatproof.methods.city.point_roles import LEFT_OUT
from splatproof.methods.city.refine import GEOMETRY, RefineSettings, refine
from splatproof.methods.city.train_block import Report, read_gaussians
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.storage.packed.writer import FileSettings
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.session import scene_digest
from splatproof.reference.compression.quantisers import Steps
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

MOVING = "moving"
"""Array beside a part's Gaussians: which of them move."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartJob:
    """Everything that one part of the refinement needs: its views, and what they show of the merged model."""

    scene: Scene
    """The block's training views, as they are, without points."""
    start: Path
    """File of the Gaussians that the part sees, with which of them move."""
    rows: Int64[Tensor, " m"]
    """Which rows of the merged model they are."""
    weights: Float[Tensor, " m"]
    """How many of the part's views show each, at least 1 for what the block owns: what its word counts."""
    settings: RefineSettings
    base: Settings
    """What the blocks were trained with."""
    facts: BlockFacts
    """Which block it is, and what its time goes by; what its refinement costs is filled in."""
    folder: Path
    pack: FileSettings | Steps | None
    """How the model will be stored, see `refine`."""
    seed: int
    backend: str
    background: tuple[float, float, float]
    checkpoint_seconds: float
    image_bytes: int

    @cached_property
    def key(self) -> str:
        """Hash of all that the refined part depends on."""
        digest = hashlib.sha256(scene_digest(self.scene).encode())
        digest.update(read_bytes(self.start))
        facts = [self.scene.name, asdict(self.settings), asdict(self.base), self.facts.steps, str(self.pack),
                 self.seed, self.backend, self.background]  # fmt: skip
        digest.update(json.dumps(facts).encode())
        return digest.hexdigest()

    @property
    def result(self) -> Path:
        """File of the part's Gaussians, refined."""
        return self.folder / "refined.safetensors"

    @property
    def record(self) -> Path:
        """The file that says that the part is refined: key and facts."""
        return self.folder / "part.json"

    def done(self) -> BlockFacts | None:
        """What the part has cost; None if it is not refined, or lies under another key."""
        return read_facts(self.record, self.key)

    def work(self, report: Report) -> BlockFacts:
        """Refine the part, or go on with it.

        Args:
            report: Called as report(step, total, values) every few steps.
        """
        if (found := self.done()) is not None:
            return found
        run = Run(seed=self.seed, backend=self.backend, background=self.background, report=report,
                  checkpoint_seconds=self.checkpoint_seconds, image_bytes=self.image_bytes)  # fmt: skip
        marks, _ = read_tensors(self.start)
        peak: dict[str, float] = {}
        with peak_within(peak, "mb"):
            refined = refine(
                read_gaussians(self.start), self.scene, self.settings, self.base, run, self.folder, self.pack,
                marks[MOVING], steps=self.facts.steps,
            )  # fmt: skip
        write_tensors(self.result, {name: getattr(refined.model, name) for name in FIELDS})
        facts = replace(
            self.facts,
            seconds=refined.seconds,
            cpu_seconds=refined.cpu_seconds,
            peak_mb=peak.get("mb", peak_memory_mb()),
        )
        write_facts(self.record, self.key, facts)
        return facts


@dataclass(frozen=True, kw_only=True, eq=False)
class Whole:
    """A merged model that is refined in parts, and what all parts have in common."""

    owners: Int64[Tensor, " n"]
    """Block of each of its Gaussians."""
    moving: Bool[Tensor, " n"] | None
    """Gaussians whose geometry is fitted too; None: none. A part moves only what its block owns."""
    scene: Scene
    views: Sequence[Bool[Tensor, " v"]]
    """For each block, which of the scene's views train it."""
    blocks: Sequence[BlockFacts]
    """Facts of each block's training: pairs of Gaussian and tile are taken to be in proportion."""
    settings: RefineSettings
    base: Settings
    """What the blocks were trained with."""
    pack: FileSettings | Steps | None
    """How the model will be stored, see `refine`."""


def part_jobs(model: Gaussians, whole: Whole, run: Run, folder: Path) -> tuple[PartJob, ...]:
    """A job for each block that owns a Gaussian and has a view; its Gaussians are written to its folder.

    Args:
        model: The merged model, already cleaned.
        whole: What all parts have in common.
        run: Seed, backend, background, checkpoints.
        folder: Where each part gets a folder of its own.
    """
    scene, settings = whole.scene, whole.settings
    jobs, nothing = [], torch.full((len(scene.points),), LEFT_OUT, dtype=torch.int8)
    for block, mask in enumerate(whole.views):
        own = whole.owners == block
        if not bool(own.any()) or not bool(mask.any()):
            continue
        cameras = [scene.views[i].camera for i in mask.nonzero()[:, 0].tolist()]
        seen_by = shown_by(cameras, model.means.double())
        rows = (own | (seen_by > 0)).nonzero()[:, 0]
        seen = {name: getattr(model, name)[rows] for name in FIELDS}
        moves = torch.zeros_like(own) if whole.moving is None else whole.moving & own
        at = folder / f"part-{block}"
        start = at / "start.safetensors"
        write_tensors(start, seen | {MOVING: moves[rows]})
        known = whole.blocks[block]
        share = len(rows) / known.gaussians if known.gaussians else 1.0
        steps = settings.steps(whole.base, len(scene.train), len(cameras))
        facts = replace(
            known, steps=steps, gaussians=float(len(rows)),
            pairs=known.pairs * share, seconds=0.0, cpu_seconds=0.0, peak_mb=0.0,
        )  # fmt: skip
        jobs.append(
            PartJob(
                scene=block_scene(scene, mask, nothing), start=start, rows=rows,
                weights=torch.where(own[rows], seen_by[rows].clamp(min=1), seen_by[rows]).float(),
                settings=settings, base=whole.base, facts=facts, folder=at, pack=whole.pack,
                seed=run.seed + SEEDS_APART * block, backend=run.backend, background=run.background,
                checkpoint_seconds=run.checkpoint_seconds,
                image_bytes=max(run.image_bytes // run.workers, 1),
            )
        )  # fmt: skip
    return tuple(jobs)


def refine_parts(jobs: Sequence[PartJob], run: Run, report: Report) -> tuple[BlockFacts, ...]:
    """Refine every part where blocks are trained.

    Args:
        jobs: The parts.
        run: Engine, workers and threads.
        report: Called as report(step, total, values), of all parts' steps together.

    Returns: What each part cost.
    """
    return tuple(
        run_blocks(
            jobs, engine=run.engine, workers=run.workers, threads=run.threads,
            report=_summed(jobs, report),
        )
    )  # fmt: skip


def mean_of_parts(
    model: Gaussians, owners: Int64[Tensor, " n"], jobs: Sequence[PartJob]
) -> Gaussians:
    """The model that refined parts make together.

    Opacity and colour of a Gaussian become the mean of what the parts made of it, weighted by how many of each part's
    views show it; geometry is what the part of the block that owns it made of it. What nobody shows stays as it is.

    Args:
        model: The merged model, already cleaned.
        owners: Block of each of its Gaussians.
        jobs: The parts, all done.

    Returns: The refined model, in the order of the merged one.

    Source: ours; the mean over parts is that of federated averaging, McMahan et al. 2017.
    """
    weights = torch.zeros(len(model))
    for job in jobs:
        weights[job.rows] += job.weights
    found = {name: getattr(model, name).clone() for name in FIELDS}
    for job in jobs:
        part, own = read_gaussians(job.result), owners[job.rows] == job.facts.block
        share = job.weights / weights[job.rows]
        for name, values in found.items():
            mine = getattr(part, name)
            if name in GEOMETRY:
                values[job.rows[own]] = mine[own]
            else:  # as a change, so that what nobody changes is the same to the bit
                change = mine - getattr(model, name)[job.rows]
                values[job.rows] += share.reshape(-1, *[1] * (change.ndim - 1)) * change
    return Gaussians(**found)


def _summed(jobs: Sequence[PartJob], report: Report) -> BlocksReport:
    """What hears every part, and tells of all together."""
    done, total = [0] * len(jobs), sum(job.facts.steps for job in jobs)

    def heard(index: int, step: int, of: int, values: dict[str, float]) -> None:
        del of
        done[index] = step
        report(sum(done), total, values)

    return heard
