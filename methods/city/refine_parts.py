"""The refinement in parts: what each block owns is fitted to the block's own views, wherever blocks are trained."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from splatproof.base.files import read_bytes, read_text, write_text
from splatproof.base.memory import peak_memory_mb
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.coarse import shown
from splatproof.methods.city.executor import BlocksReport, run_blocks
from splatproof.methods.city.jobs import SEEDS_APART, block_scene
from splatproof.methods.city.point_roles import LEFT_OUT
from splatproof.methods.city.refine import RefineSettings, refine
from splatproof.methods.city.train_block import Report, read_gaussians, select
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.storage.packed.writer import FileSettings
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.session import scene_digest
from splatproof.reference.compression.quantisers import Steps
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

OWN, MOVING = "own", "moving"
"""Arrays beside a part's Gaussians: which of them its block owns, and which of those move."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartJob:
    """Everything that one part of the refinement needs: its views, and what they show of the merged model."""

    scene: Scene
    """The block's training views, as they are, without points."""
    start: Path
    """File of the Gaussians that the part sees, with which of them are its own and which move."""
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

    @property
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
        """File of the block's own Gaussians, refined."""
        return self.folder / "refined.safetensors"

    @property
    def record(self) -> Path:
        """The file that says that the part is refined: key and facts."""
        return self.folder / "part.json"

    def done(self) -> BlockFacts | None:
        """What the part has cost; None if it is not refined, or lies under another key."""
        if not self.record.exists():
            return None
        stored = json.loads(read_text(self.record))
        return BlockFacts(**stored["facts"]) if stored["key"] == self.key else None

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
        refined = refine(
            read_gaussians(self.start), self.scene, self.settings, self.base, run, self.folder, self.pack,
            marks[MOVING], steps=self.facts.steps,
        )  # fmt: skip
        own = select(refined.model, marks[OWN])
        write_tensors(self.result, {name: getattr(own, name) for name in FIELDS})
        facts = replace(
            self.facts,
            seconds=refined.seconds,
            cpu_seconds=refined.cpu_seconds,
            peak_mb=peak_memory_mb(),
        )
        write_text(self.record, json.dumps({"key": self.key, "facts": asdict(facts)}) + "\n")
        return facts


def part_jobs(
    model: Gaussians,
    owners: Int64[Tensor, " n"],
    moving: Bool[Tensor, " n"] | None,
    scene: Scene,
    views: Sequence[Bool[Tensor, " v"]],
    blocks: Sequence[BlockFacts],
    settings: RefineSettings,
    base: Settings,
    run: Run,
    folder: Path,
    pack: FileSettings | Steps | None,
) -> tuple[PartJob, ...]:
    """A job for each block that owns a Gaussian and has a view; its Gaussians are written to its folder.

    Args:
        model: The merged model, already cleaned.
        owners: Block of each Gaussian.
        moving: Gaussians whose geometry is fitted too; None: none. A part moves only what its block owns.
        scene: The whole scene.
        views: For each block, which of the scene's views train it.
        blocks: Facts of each block's training: pairs of Gaussian and tile are taken to be in proportion.
        settings: How it is refined.
        base: Settings that the blocks were trained with.
        run: Seed, backend, background, checkpoints.
        folder: Where each part gets a folder of its own.
        pack: How the model will be stored, see `refine`.
    """
    jobs, nothing = [], torch.full((len(scene.points),), LEFT_OUT, dtype=torch.int8)
    for block, mask in enumerate(views):
        own = owners == block
        if not bool(own.any()) or not bool(mask.any()):
            continue
        chosen = mask.nonzero()[:, 0].tolist()
        cameras = [scene.views[i].camera for i in chosen]
        rows = (own | shown(cameras, model.means.double())).nonzero()[:, 0]
        moves = torch.zeros_like(own) if moving is None else moving & own
        at = folder / f"part-{block}"
        start = at / "start.safetensors"
        seen = select(model, rows)
        write_tensors(
            start,
            {name: getattr(seen, name) for name in FIELDS} | {OWN: own[rows], MOVING: moves[rows]},
        )
        known = blocks[block]
        share = len(rows) / known.gaussians if known.gaussians else 1.0
        facts = replace(
            known, steps=settings.steps(base, len(scene.train), len(chosen)), gaussians=float(len(rows)),
            pairs=known.pairs * share, seconds=0.0, cpu_seconds=0.0, peak_mb=0.0,
        )  # fmt: skip
        jobs.append(
            PartJob(
                scene=block_scene(scene, mask, nothing), start=start, settings=settings, base=base, facts=facts,
                folder=at, pack=pack, seed=run.seed + SEEDS_APART * block, backend=run.backend, background=run.background,
                checkpoint_seconds=run.checkpoint_seconds,
                image_bytes=max(run.image_bytes // run.workers, 1),
            )
        )  # fmt: skip
    return tuple(jobs)


def refine_parts(
    model: Gaussians,
    owners: Int64[Tensor, " n"],
    jobs: Sequence[PartJob],
    run: Run,
    report: BlocksReport,
) -> tuple[Gaussians, tuple[BlockFacts, ...]]:
    """Refine every part where blocks are trained, and put each block's own Gaussians back into their rows.

    Args:
        model: The merged model, already cleaned.
        owners: Block of each Gaussian.
        jobs: Of `part_jobs`; what no part owns stays as it is.
        run: Engine, workers and threads.
        report: Hears where each part is.

    Returns: The refined model, in the order of the merged one; and what each part cost.
    """
    facts = run_blocks(
        jobs, engine=run.engine, workers=run.workers, threads=run.threads, report=report
    )
    whole = {name: getattr(model, name).clone() for name in FIELDS}
    for job in jobs:
        own = read_gaussians(job.result)
        for name, values in whole.items():
            values[owners == job.facts.block] = getattr(own, name)
    return Gaussians(**whole), tuple(facts)
