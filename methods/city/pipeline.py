"""From a scene to one model: partition, blocks, stitch, refine, compress; each stage resumable."""

import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from splatproof.base.files import read_bytes
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.city import refine as refinement
from splatproof.methods.city.balance import Training, cut
from splatproof.methods.city.block_facts import BlockFacts, least_visited, told_by, with_parts
from splatproof.methods.city.block_model import BlockModel
from splatproof.methods.city.block_terms import with_scaled_priors
from splatproof.methods.city.coarse import coarse_stage
from splatproof.methods.city.executor import check_engine, run_blocks
from splatproof.methods.city.ground import ground
from splatproof.methods.city.jobs import block_jobs, trained_on
from splatproof.methods.city.levels import block_levels, levelled
from splatproof.methods.city.memory_plan import plan_memory
from splatproof.methods.city.merge import kept_rows, write_merged
from splatproof.methods.city.model import CityModel
from splatproof.methods.city.partition import Partition, check_blocks
from splatproof.methods.city.progress import Progress
from splatproof.methods.city.refine_parts import Whole, mean_of_parts, part_jobs, refine_parts
from splatproof.methods.city.settings import CitySettings
from splatproof.methods.city.small_file import compress, file_steps, order_in_file
from splatproof.methods.city.stages import Stages
from splatproof.methods.city.stitch import near_walls
from splatproof.methods.city.train_block import BlockJob, least_visits, read_gaussians, select
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.reconstruction import ARRAYS, Origin
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.refiners import refiner_of
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.threedgs.cost import mean_gaussians
from splatproof.methods.threedgs.fit import started
from splatproof.methods.training.session import run_key
from splatproof.methods.training.threads import threads
from splatproof.reference.stitching.preclean import CleanSettings
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

OFF = 0.02
"""A factor on a colour that is so far from 1 is told."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Merged:
    """Gaussians of all blocks, and where each comes from."""

    model: Gaussians
    blocks: Int64[Tensor, " n"]
    """Block that trained each Gaussian."""
    distances: Float[Tensor, " n"]
    """Normalised distance of each Gaussian to that block: at most 1 in its core."""
    unfaded: Float[Tensor, " n"] | None = None
    """Opacity logit that each Gaussian had before it faded; None: nothing faded."""

    def take(self, rows: Tensor) -> "Merged":
        """Some of the Gaussians, with their blocks and distances.

        Args:
            rows: Mask or indices.
        """
        return Merged(
            model=select(self.model, rows),
            blocks=self.blocks[rows],
            distances=self.distances[rows],
            unfaded=None if self.unfaded is None else self.unfaded[rows],
        )

    def clean(self, settings: CleanSettings) -> Bool[Tensor, " n"]:
        """Which Gaussians stay when invisible and oversized ones go: by what they were before they faded.

        By what is left of them one of several that share a place would go and the others stay: shares would no longer
        sum to 1.

        Args:
            settings: Thresholds.
        """
        whole = self.unfaded
        solid = self.model if whole is None else replace(self.model, opacity_logits=whole)
        return refinement.clean(solid, settings)


def fit(scene: Scene, settings: CitySettings, run: Run, *, method: str) -> CityModel:
    """Reconstruct a scene block by block.

    Args:
        scene: With sparse points, their tracks, and training views.
        settings: What is chosen about the method; each stage looks at its own part.
        run: Where checkpoints go; a run found there goes on at the stage that was broken off.
        method: Name of the method.

    Raises: DataError for a scene that cannot be cut or trained on; UsageError if the folder belongs
        to another run; MissingError if the blocks cannot fit into memory; MissingError or DataError, before
        anything else, where a refiner of side views lacks its library or weights, or an engine its package.
    """
    check_engine(run.engine, run.workers)
    weights = refiner_of(settings.side).weights  # before minutes of matching photos
    scene = started(scene, settings.training, run)
    check_blocks(scene, settings.blocks, settings.partition)
    with threads(run.threads), _work_folder(run) as folder:
        special = [method]
        if settings.block_terms.depth:
            scene = with_scaled_priors(scene)
            special.append(scene.facts.get("depth_prior_sha256", ""))
        if weights:
            special.append(weights)
        stages = Stages(folder, run_key(scene, settings, run, *special), run.on_stage)
        progress = Progress(run, settings, len(scene.train))
        coarse, elsewhere = None, 0.0
        if settings.coarse_iterations:
            own = replace(settings.training, iterations=settings.coarse_iterations)
            coarse, work = coarse_stage(scene, own, run, folder, progress.coarse)
            first = stages.run("coarse", work, coarse.exists)
            elsewhere = first.get("cpu_seconds", 0.0) if first.get("shared") else 0.0
        found = _partition(stages, scene, settings, run, coarse)
        jobs = block_jobs(
            scene, found, settings.training, run, run.cache or folder / "blocks",
            auxiliary=settings.auxiliary, follow=settings.follow, coarse=coarse,
            surrounding=settings.surrounding, margin=settings.partition.margin, even=settings.even,
            sampling=settings.bins if settings.sampling == "balanced" else None, side=settings.side,
            weights=weights, terms=settings.block_terms, planted=settings.planted,
        )  # fmt: skip
        told = stages.run(
            "blocks",
            partial(_blocks, jobs, run, progress),
            lambda: "stitch" in stages.done or all(job.done() is not None for job in jobs),
        )
        facts = tuple(BlockFacts(**block) for block in told["blocks"])
        elsewhere, peaks = elsewhere + told.get("elsewhere", 0.0), [one.peak_mb for one in facts]
        for name, value in told_by(facts).items():
            run.on_fact(name, value)
        if (visits := least_visited(facts)) is not None:
            run.on_count("least_visits", visits)
        for one in facts:
            if one.note:
                run.say(f"block {one.block}: {one.note}")
        told = stages.run(
            "stitch", partial(_stitch, scene, settings, run, jobs, found, folder, method)
        )
        cores = told.get("cores", [-1] * len(facts))  # which an earlier release did not count
        facts = tuple(
            replace(one, kept=n, core=core)
            for one, n, core in zip(facts, told["kept"], cores, strict=True)
        )
        for one in facts:
            if one.primitives and not one.kept:
                run.say(f"block {one.block}: lost all {one.primitives} Gaussians in the merge")
        merged, packed, bytes_of, steps = _read_merged(folder / "merged"), None, {}, None
        alone: dict[str, float] = {}
        if settings.gcr:
            path = folder / "refined.safetensors"
            refined = stages.run(
                "refine",
                partial(_refine, merged, scene, settings, run, path, progress, found, facts),
            )
            merged, steps = _read_refined(merged, path), refined["steps"]
            parts = [BlockFacts(**part) for part in refined.get("parts", ())]
            elsewhere += refined.get("elsewhere", 0.0)
            peaks += [part.peak_mb for part in parts]
            facts, alone = with_parts(facts, parts), refined.get("alone", {})
        run.on_elsewhere(elsewhere, max(peaks))
        if settings.quantise:
            path = folder / "model.spgs"
            chosen = file_steps(merged.model, settings, steps)
            merged = merged.take(order_in_file(merged.model, settings, chosen))
            small = stages.run(
                "compress", partial(compress, merged.model, settings, path, scene, chosen)
            )
            packed, bytes_of = read_bytes(path), small["parts"]
            merged = replace(merged, model=read_packed(path, threads=run.threads)[0])
        run.on_stage("train", sum(stages.seconds.values()))
    return CityModel(
        model=merged.model, blocks=merged.blocks, distances=merged.distances, mode=settings.mode, shift=scene.shift, units=scene.units,
        backend=run.backend, regions=found.regions, stage_seconds=stages.seconds, stage_cpu_seconds=stages.cpu_seconds, packed=packed,
        packed_parts=bytes_of, refine_alone=alone,
        block_facts=facts, stage_peak_mb=stages.peak_mb,
    )  # fmt: skip


@contextmanager
def _work_folder(run: Run) -> Iterator[Path]:
    """The run's checkpoint folder, or one that is gone afterwards."""
    if run.folder is not None:
        folder = run.folder / "checkpoint"
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="splatproof-") as name:
        yield Path(name)


def _partition(
    stages: Stages, scene: Scene, settings: CitySettings, run: Run, coarse: Path | None
) -> Partition:
    """Cut the scene; done again when a run goes on, because it is short and always the same."""
    found: list[Partition] = []

    def work() -> dict[str, Any]:
        model = None if coarse is None else read_gaussians(coarse)
        points = len(scene.points)
        grown = mean_gaussians(settings.iterations, points, settings.density.most)
        training = Training(
            iterations=settings.iterations, even=settings.even, auxiliary=settings.auxiliary,
            surrounding=settings.surrounding,
            thickness=1.0 if model else max(1.0, grown / max(points, 1)),
        )  # fmt: skip
        found.append(
            cut(scene, settings.blocks, settings.partition, training, backend=run.backend,
                coarse=model)
        )  # fmt: skip
        return {"note": found[0].note}

    stages.run("partition", work)
    if not found:
        work()
    if found[0].note:
        run.say(f"partition {found[0].method}: {found[0].note}")
    return found[0]


def _blocks(jobs: Sequence[BlockJob], run: Run, progress: Progress) -> dict[str, Any]:
    """Train all blocks where the run says."""
    if run.engine != "ray":  # a cluster's machines have memory of their own
        run.say(plan_memory(jobs, run.workers).text)
    before = [job.done() is not None for job in jobs]
    facts = run_blocks(
        jobs, engine=run.engine, workers=run.workers, threads=run.threads, report=progress.block
    )
    visited = [
        replace(one, least_visits=least_visits(job)) for one, job in zip(facts, jobs, strict=True)
    ]
    return {"blocks": [asdict(one) for one in visited]} | _spent(facts, before, run)


def _spent(facts: Sequence[BlockFacts], before: Sequence[bool], run: Run) -> dict[str, float]:
    """Wall seconds of what was done apart, and processor seconds of what this process's clock does not know; peak memory."""
    workers = max(1, min(run.workers, len(facts)))
    apart = [was or run.engine != "inline" for was in before]
    return {
        "seconds": sum(one.seconds for one in facts) / workers,
        "elsewhere": sum(one.cpu_seconds for one, gone in zip(facts, apart, strict=True) if gone),
        "peak_mb": max((one.peak_mb for one in facts), default=0.0),
    }


def _stitch(
    scene: Scene,
    settings: CitySettings,
    run: Run,
    jobs: Sequence[BlockJob],
    found: Partition,
    folder: Path,
    method: str,
) -> dict[str, Any]:
    """Merge the blocks into folder/merged, and write whose is whose."""
    blocks = [
        BlockModel(region=region, model=job.model)
        for region, job in zip(found.regions, jobs, strict=True)
    ]
    kept, fade = kept_rows(blocks, settings, run.seed, run.threads)
    counts = write_merged(
        folder / "merged", blocks, kept,
        origin=Origin(method=method, settings=asdict(settings), scene=scene.name, seed=run.seed),
        mode=settings.mode, shift=scene.shift, units=scene.units, fade=fade,
    )  # fmt: skip
    distances, cores = [], [0] * len(blocks)
    for i, block in enumerate(blocks):
        for part in block.slices(("means",)):
            away = block.region.distance(part["means"].double())
            cores[i] += int((away <= 1).sum())
            distances.append(away.float())
    owners = torch.repeat_interleave(torch.arange(len(blocks)), torch.tensor(counts))
    away = torch.cat(distances)[torch.cat(kept)]
    whose = {"blocks": owners, "distances": away}
    if fade is not None:
        logits = [part["opacity_logits"] for block in blocks for part in block.slices(("opacity_logits",))]  # fmt: skip
        whose["unfaded"] = torch.cat(logits)[torch.cat(kept)]
    write_tensors(folder / "merged" / "blocks.safetensors", whose)
    return {"kept": counts, "cores": cores}


def _read_merged(folder: Path) -> Merged:
    whose, _ = read_tensors(folder / "blocks.safetensors")
    return Merged(model=read_gaussians(folder / ARRAYS), **whose)


def _refine(
    merged: Merged,
    scene: Scene,
    settings: CitySettings,
    run: Run,
    path: Path,
    progress: Progress,
    found: Partition,
    blocks: Sequence[BlockFacts],
) -> dict[str, Any]:
    """Clean the merged model and fit its appearance over all training views, at once or in parts."""
    began = _clocks()
    rows = merged.clean(settings.refine.clean)
    cleaned, owners = select(merged.model, rows), merged.blocks[rows]
    if settings.refine.level:
        cleaned = _at_level(cleaned, owners, scene, settings, run)
    moving = None
    if settings.refine.walls:
        moving = near_walls(cleaned.means.double(), found.regions, settings.refine.walls)
    steps, work = file_steps(cleaned, settings, None), path.parent / "refine"
    pack = steps or (settings.pack if settings.quantise else None)
    told: dict[str, Any] = {"steps": None if steps is None else asdict(steps)}
    if settings.refine.parts:
        place = ground(scene)
        views = [trained_on(place, found, block)[0] for block in range(len(blocks))]
        whole = Whole(
            owners=owners, moving=moving, scene=scene, views=views, blocks=blocks, settings=settings.refine,
            base=settings.training, pack=pack,
        )  # fmt: skip
        jobs = part_jobs(cleaned, whole, run, work)
        before = [job.done() is not None for job in jobs]
        shared_out = _clocks()
        parts = refine_parts(jobs, run, progress.parts)
        back = _clocks()
        model = mean_of_parts(cleaned, owners, jobs)
        told |= {"parts": [asdict(one) for one in parts]} | _spent(parts, before, run)
        alone = _clocks() - back + shared_out - began
        told["alone"] = dict(zip(("seconds", "cpu_seconds"), alone.tolist(), strict=True))
    else:
        model, seconds, cpu_seconds = refinement.refine(
            cleaned, scene, settings.refine, settings.training,
            replace(run, report=progress.refine), work, pack, moving,
        )  # fmt: skip
        told |= {"seconds": seconds, "cpu_seconds": cpu_seconds}
    write_tensors(path, {name: getattr(model, name) for name in FIELDS} | {"rows": rows})
    shutil.rmtree(work, ignore_errors=True)
    return told | {"cleaned": int((~rows).sum())}


def _clocks() -> Float64[Tensor, "2"]:
    """Wall and processor seconds of this process, from a start of their own."""
    return torch.tensor([time.perf_counter(), time.process_time()], dtype=torch.float64)


def _at_level(
    model: Gaussians, owners: Int64[Tensor, " n"], scene: Scene, settings: CitySettings, run: Run
) -> Gaussians:
    """The model with all blocks at the level of the photos, and a word on those that were not."""
    backend = get_backend(run.backend)
    factors = block_levels(
        model, owners, settings.blocks, scene.train_views, backend, settings.mode
    )
    for block, one in enumerate(factors):
        if bool(((one - 1).abs() > OFF).any()):
            told = ", ".join(f"{factor:.3f}" for factor in one.tolist())
            run.say(f"block {block}: red, green and blue times {told}, which is the photos' level")
    return levelled(model, owners, factors)


def _read_refined(merged: Merged, path: Path) -> Merged:
    tensors, _ = read_tensors(path)
    return replace(merged.take(tensors["rows"]), model=read_gaussians(path))
