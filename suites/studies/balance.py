"""`bench study balance`: processor seconds of blocks where Gaussians are the cost, partition by partition.

Scenes are made dense enough first: each sparse point becomes several on the surface around it. Blocks of one
partition take turns, so that what else the machine does meets all of them. Nothing is densified: what is
measured is a step's time, times as many steps as give every view of a block one visit.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree

from splatproof.base.errors import MissingError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.city.balance import Training, cut, expected_works
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.block_work import STEP_COST, start_of
from splatproof.methods.city.ground import ground
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import Partition, PartitionSettings
from splatproof.methods.city.train_block import BlockJob, prepare
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.threads import threads
from splatproof.metrics.balance import spread
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.partition.block_time import BlockWork, block_seconds, fit_step_cost
from splatproof.reference.types.scene import Scene, SparsePoints

SCENES = {
    "city": "default",
    "brighton_beach": "city_400",
    "caliterra": "city_400",
    "seneca": "city_400",
}
"""Scene: protocol that it is opened under."""
BLOCKS, EACH = 4, 300_000
"""Blocks, and Gaussians for each of them, before rims and context are added."""
TURNS, WARM, DRAWS = 8, 2, 1000
"""Turns of each block, over which it visits every view once; steps before the first; bootstraps of the turns."""
QUICK_SCENE, QUICK_BLOCKS, QUICK_EACH, QUICK_TURNS = {"courtyard": "default"}, 2, 2_000, 2
WIDE = 0.15
"""Margin of ODBP's blocks, as in suite city."""
PARTITIONS = {
    "odbp": PartitionSettings(margin=WIDE),
    "odbp, by time": PartitionSettings(margin=WIDE, balance="time"),
    "blockgaussian": PartitionSettings(method="blockgaussian"),
    "vastgaussian": PartitionSettings(method="vastgaussian"),
    "citygaussian": PartitionSettings(method="citygaussian"),
}
NEAR = 8
"""Neighbours that say how the surface lies at a point."""
SETTINGS = Settings(sh_interval=0)
"""All bands of colour in use from the first step, as in most of a training."""
Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Timed:
    """What the blocks of one partition took."""

    works: tuple[BlockWork, ...]
    """One visit of each view."""
    seconds: np.ndarray
    """Processor seconds of that by turn and block, each turn as if it were the whole."""


def rows(*, quick: bool) -> Iterator[Row]:
    """A row a scene and partition, then the coefficients that fit all blocks of partitions not cut by time.

    Args:
        quick: One small scene, two blocks, partitions by ODBP.
    """
    found: list[Timed] = []
    for name, protocol in (QUICK_SCENE if quick else SCENES).items():
        try:
            scene = open_scene(name, load_protocol(protocol)).for_training()
        except MissingError as error:
            yield {"scene": name, "note": str(error)}
            continue
        for partition in list(PARTITIONS)[: 2 if quick else None]:
            row, timed = measured(
                scene, partition, blocks=QUICK_BLOCKS if quick else BLOCKS,
                each=QUICK_EACH if quick else EACH, turns=QUICK_TURNS if quick else TURNS,
            )  # fmt: skip
            yield {"scene": name, "partition": partition} | row
            if PARTITIONS[partition].balance == "load":
                found.append(timed)
    yield fitted(found)


def measured(
    scene: Scene, partition: str, *, blocks: int, each: int, turns: int
) -> tuple[Row, Timed]:
    """One partition of one scene: how even its blocks' times are, predicted and measured.

    Args:
        scene: With training views and sparse points.
        partition: One of PARTITIONS.
        blocks: Number of blocks.
        each: Gaussians for each of them.
        turns: Turns of each block.
    Returns: The row, and what was measured.
    """
    copies = max(1, round(blocks * each / len(scene.points)))
    training = Training(iterations=1000, even="visits", thickness=float(copies))
    began = time.process_time()
    found = cut(scene, blocks, PARTITIONS[partition], training)
    cut_seconds = time.process_time() - began
    works = expected_works(ground(scene), found, training, WIDE, start_of(scene, None))
    predicted = np.array([block_seconds(one, STEP_COST) for one in works])
    jobs = dense_jobs(scene, found, copies)
    timed = timed_blocks(jobs, turns)
    low, high = interval(timed.seconds)
    mean = timed.seconds.mean(axis=0)
    steps = [mean[i] / one.steps for i, one in enumerate(timed.works)]
    return {
        "gaussians": float(np.mean([one.gaussians for one in timed.works])),
        "views": float(np.mean([one.steps for one in timed.works])),
        "predicted": spread(predicted)[1],
        "max_over_mean": spread(mean)[1], "low": low, "high": high,
        "equal_steps": spread(np.array(steps))[1],
        "slowest": float(mean.max()), "total": float(mean.sum()), "cut_seconds": cut_seconds,
        "blocks": [vars(one) | {"seconds": s} for one, s in zip(timed.works, mean.tolist(), strict=True)],
    }, timed  # fmt: skip


def interval(seconds: Float[np.ndarray, "t k"]) -> tuple[float, float]:
    """95 % of what max / mean over blocks is in DRAWS bootstraps of the turns; of the blocks' means, so that
    what is noise of one turn is no spread.

    Args:
        seconds: A row a turn, a column a block.
    """
    generator = np.random.default_rng(0)
    drawn = seconds[generator.integers(0, len(seconds), (DRAWS, len(seconds)))].mean(axis=1)
    low, high = np.percentile(drawn.max(axis=1) / drawn.mean(axis=1), [2.5, 97.5])
    return float(low), float(high)


def dense_jobs(scene: Scene, found: Partition, copies: int) -> tuple[BlockJob, ...]:
    """The jobs of a partition of the sparse points, with each of them in so many copies.

    Args:
        scene: The scene that was cut.
        found: Its partition.
        copies: Points in place of each.
    """
    dense = thickened(scene, copies, torch.Generator().manual_seed(0))
    again = replace(
        found,
        labels=found.labels.repeat_interleave(copies),
        points=tuple(one.repeat_interleave(copies) for one in found.points),
    )
    return block_jobs(dense, again, SETTINGS, Run(seed=0), Path("blocks"))


def thickened(scene: Scene, copies: int, generator: torch.Generator) -> Scene:
    """The scene with each point in so many copies, seen by the same views.

    Copies lie on the surface that the points are taken from: shaken along the two longer axes of a point's
    NEAR neighbours, by half the way to the nearest.

    Args:
        scene: With more sparse points than NEAR.
        copies: Points in place of each, >= 1.
        generator: Source of the shakes.
    """
    points = scene.points
    places = points.positions.double()
    away, which = KDTree(places.numpy()).query(places.numpy(), k=NEAR + 1)
    around = places[torch.from_numpy(which)] - places[:, None]
    axes = torch.linalg.svd(around, full_matrices=False).Vh[:, :2]
    source = torch.arange(len(points)).repeat_interleave(copies)
    shake = torch.rand(len(source), 2, generator=generator, dtype=torch.float64) - 0.5
    shake *= torch.from_numpy(away[:, 1])[source, None]
    moved = (shake[:, :, None] * axes[source]).sum(dim=1)
    lengths = points.track_starts.diff()[source]
    starts = torch.cat([lengths.new_zeros(1), lengths.cumsum(0)])
    first = (points.track_starts[:-1][source] - starts[:-1]).repeat_interleave(lengths)
    return replace(
        scene,
        points=SparsePoints(
            positions=points.positions[source] + moved,
            colours=points.colours[source],
            track_starts=starts,
            track_views=points.track_views[first + torch.arange(int(starts[-1]))],
        ),
    )


def timed_blocks(jobs: Sequence[BlockJob], turns: int) -> Timed:
    """Train the blocks a little, in turns, on one thread.

    Args:
        jobs: Blocks that have views and points; one without is left out.
        turns: Turns of each.
    """
    with threads(1):
        trainers = [
            Trainer(*prepare(job, None, run), run)
            for job in jobs
            if job.scene.train
            for run in [Run(seed=job.seed, image_bytes=job.image_bytes)]
        ]
        for one in trainers:
            for _ in range(WARM):
                one.advance()
        facts: list[BlockFacts] = [job.facts for job in jobs if job.scene.train]
        steps = [-(-one.views // turns) for one in facts]
        seconds = [
            [_spent(one, count) / count * of.views
             for one, count, of in zip(trainers, steps, facts, strict=True)]
            for _ in range(turns)
        ]  # fmt: skip
    works = tuple(replace(one.work, steps=float(one.views)) for one in facts)
    return Timed(works=works, seconds=np.array(seconds))


def _spent(trainer: Trainer, steps: int) -> float:
    began = time.process_time()
    for _ in range(steps):
        trainer.advance()
    return time.process_time() - began


def fitted(found: Sequence[Timed]) -> Row:
    """The coefficients that fit the measured blocks best, and how far off they and the shipped ones are.

    Args:
        found: What was measured.
    """
    works = [work for one in found for work in one.works]
    seconds = [s for one in found for s in one.seconds.mean(axis=0).tolist()]
    if not works:
        return {"scene": "all", "note": "nothing was measured"}
    cost = fit_step_cost(works, seconds)
    scale = np.exp(
        np.mean(
            [np.log(s / block_seconds(w, STEP_COST)) for w, s in zip(works, seconds, strict=True)]
        )
    )
    off = [abs(np.log(s / block_seconds(w, cost))) for w, s in zip(works, seconds, strict=True)]
    shipped = [
        abs(np.log(s / block_seconds(w, STEP_COST) / scale))
        for w, s in zip(works, seconds, strict=True)
    ]
    note = (
        f"pixel {cost.pixel:.3g} s, gaussian {cost.gaussian:.3g} s, pair {cost.pair:.3g} s: mean error {100 * np.mean(off):.0f} %, "
        f"of the shipped coefficients in this machine's unit {100 * np.mean(shipped):.0f} %"
    )  # fmt: skip
    return {"scene": "all", "partition": "fit", "note": note} | vars(cost)
