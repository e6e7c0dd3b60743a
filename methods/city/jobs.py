"""From a partition to the jobs that train its blocks."""

from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Int8
from torch import Tensor

from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.ground import Ground, ground
from splatproof.methods.city.partition import Partition
from splatproof.methods.city.point_roles import LEFT_OUT, Auxiliary, Surrounding, roles_of
from splatproof.methods.city.train_block import BlockJob
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.partition.ghosts import RIM
from splatproof.reference.partition.view_sampling import SamplingSettings
from splatproof.reference.partition.visibility import shared_points
from splatproof.reference.types.scene import Scene, SparsePoints

SEEDS_APART = 1_000_003
"""How far the seeds of two neighbouring blocks lie apart; block 0 has the run's own, so that a
scene in one block is what method 3dgs makes of it."""


def block_jobs(
    scene: Scene,
    found: Partition,
    settings: Settings,
    run: Run,
    cache: Path,
    *,
    auxiliary: Auxiliary = "none",
    follow: bool = False,
    surrounding: Surrounding = "box",
    sampling: SamplingSettings | None = None,
    coarse: Path | None = None,
) -> tuple[BlockJob, ...]:
    """A job for each block, in a folder that is named by what the block is trained from.

    A block that no view was assigned to takes all training views that see a point of its own.

    Args:
        scene: The whole scene.
        found: Its partition.
        settings: What the training of each block follows.
        run: Seed, backend, background and checkpoints.
        cache: Folder of all blocks' folders; runs that share it share equal blocks.
        auxiliary: What takes part beside the block's own points.
        follow: Whether opacity and colour of ghosts are trained too.
        surrounding: Where ghosts are taken from.
        sampling: Bins of balanced sampling of views; None: uniform sampling.
        coarse: File of a coarse model that all blocks start from; None: they start from points.
    """
    place = ground(scene)
    return tuple(
        _job(place, found, block, settings, run, cache, auxiliary=auxiliary, follow=follow,
             surrounding=surrounding, sampling=sampling, coarse=coarse)
        for block in range(len(found.views))
    )  # fmt: skip


def _job(
    place: Ground,
    found: Partition,
    block: int,
    settings: Settings,
    run: Run,
    cache: Path,
    *,
    auxiliary: Auxiliary,
    follow: bool,
    surrounding: Surrounding,
    sampling: SamplingSettings | None,
    coarse: Path | None,
) -> BlockJob:
    scene, points = place.scene, place.scene.points
    own, note, views = found.labels == block, "", found.views[block]
    if not bool(views.any()):
        views = place.trained & (shared_points(points, own, len(scene.views)) > 0)
        note = "no view covers it by the shares; it takes those that see a point of it"
    near = None
    if surrounding == "region" and auxiliary in ("ghosts", "both"):
        near = found.regions[block].distance(points.positions) <= 1 + RIM
    roles = roles_of(
        points, found.points[block], views, found.labels, block, place.positions, auxiliary, near
    )
    job = BlockJob(
        scene=_part(scene, views, roles), roles=roles[roles != LEFT_OUT], settings=settings,
        facts=BlockFacts(block=block, views=int(views.sum()), points=int(own.sum()),
                         load=int(place.loads[own].sum()), note=note),
        folder=cache, centre=found.regions[block].centre, frame=place.frame, sampling=sampling,
        follow=follow, start=coarse, seed=run.seed + SEEDS_APART * block, backend=run.backend,
        background=run.background, checkpoint_seconds=run.checkpoint_seconds,
        image_bytes=max(run.image_bytes // run.workers, 1),
    )  # fmt: skip
    return replace(job, folder=cache / job.key[:16])


def _part(scene: Scene, views: Bool[Tensor, " v"], roles: Int8[Tensor, " n"]) -> Scene:
    """The scene of one block: its views, all for training, and the points that have a role."""
    chosen = views.nonzero()[:, 0].tolist()
    kept = roles != LEFT_OUT
    count = int(kept.sum())
    return replace(
        scene,
        views=tuple(replace(scene.views[i], load_depth=None) for i in chosen),
        train=tuple(range(len(chosen))),
        test=(),
        points=SparsePoints(
            positions=scene.points.positions[kept].clone(),
            colours=scene.points.colours[kept].clone(),
            track_starts=torch.zeros(count + 1, dtype=torch.int64),
            track_views=torch.zeros(0, dtype=torch.int64),
        ),
        left_out=(),
    )
