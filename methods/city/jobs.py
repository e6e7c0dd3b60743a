"""From a partition to the jobs that train its blocks."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Bool, Int8
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.block_terms import NO_TERMS, BlockTerms
from splatproof.methods.city.block_work import Start, block_work, start_of
from splatproof.methods.city.coarse import coarse_roles
from splatproof.methods.city.ground import Ground, ground
from splatproof.methods.city.partition import Partition
from splatproof.methods.city.planted import NO_PLANT, PlantSettings, planted_views
from splatproof.methods.city.point_roles import LEFT_OUT, Auxiliary, Surrounding, roles_of
from splatproof.methods.city.train_block import BlockJob, read_gaussians
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.settings import NO_SIDES, SideSettings
from splatproof.methods.dpgs.spirals import side_cameras
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.partition.ghosts import RIM
from splatproof.reference.partition.view_sampling import SamplingSettings
from splatproof.reference.partition.visibility import shared_points
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene, SparsePoints

Even = Literal["steps", "visits"]
"""What all blocks have equally many of. steps: training steps; visits: steps for each of its views."""
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
    margin: float = 0.0,
    even: Even = "steps",
    side: SideSettings = NO_SIDES,
    weights: str = "",
    terms: BlockTerms = NO_TERMS,
    planted: PlantSettings = NO_PLANT,
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
        margin: What a block's region is widened by where it takes its own from a coarse model.
        even: What all blocks have equally many of.
        side: Side views of each block, on spirals around its own points.
        weights: Hash of their refiner's weights.
        terms: What each block minimises beside its photos.
        planted: What is made wrong about each block's photos.

    Raises: DataError where no block has a view to train on.
    """
    place = ground(scene)
    views, notes = zip(*(trained_on(place, found, b) for b in range(len(found.views))), strict=True)
    if not any(bool(mask.any()) for mask in views):
        raise DataError(
            f"scene {scene.name!r}: no training view sees a sparse point of any of its {len(views)} blocks by "
            f"the {len(scene.points.track_views)} observations of the points' tracks; make points that have "
            "tracks with --points triangulated, or take citygaussian or vastgaussian, which need none"
        )
    model = None if coarse is None else read_gaussians(coarse)
    start, roles = start_of(scene, model), None
    if model is not None:
        roles = coarse_roles(start.means, scene, found, views, auxiliary, margin)
    counts = [int(mask.sum()) for mask in views]
    steps = block_steps(settings.iterations, counts, even)
    return tuple(
        _job(place, found, block, replace(settings, iterations=steps[block]), run, cache,
             views=views[block], note=notes[block], auxiliary=auxiliary, follow=follow,
             surrounding=surrounding, sampling=sampling, coarse=coarse, side=side, weights=weights, terms=terms,
             planted=planted, start=start, roles=None if roles is None else roles[block])
        for block in range(len(views))
    )  # fmt: skip


def block_steps(iterations: int, views: Sequence[int], even: Even) -> list[int]:
    """Training steps of each block; they sum to `iterations` times the blocks that have a view.

    Args:
        iterations: Steps of each block, or of a block on average.
        views: Number of each block's training views.
        even: "steps": the same for all; "visits": in proportion to the views, so that every block
            visits each of its views equally often.

    Returns: At least 1 for each block. A block without views, which will not be trained, has
        `iterations`.

    Source: ours; remainders go to the largest ones (Hamilton's method).
    """
    held = [i for i, count in enumerate(views) if count]
    if even == "steps" or not held:
        return [iterations] * len(views)
    total, every = iterations * len(held), sum(views)
    shares = {i: views[i] * total / every for i in held}
    steps = [max(1, int(shares[i])) if i in shares else iterations for i in range(len(views))]
    left = total - sum(steps[i] for i in held)
    for i in sorted(held, key=lambda i: steps[i] - shares[i])[: max(left, 0)]:
        steps[i] += 1
    return steps


def trained_on(place: Ground, found: Partition, block: int) -> tuple[Bool[Tensor, " v"], str]:
    """Which views train a block, and what is to be said of that.

    Args:
        place: The whole scene.
        found: Its partition.
        block: Number of the block.
    """
    views = found.views[block]
    if bool(views.any()):
        return views, ""
    own = found.labels == block
    seeing = place.trained & (shared_points(place.scene.points, own, len(place.scene.views)) > 0)
    return seeing, "no view covers it by the shares; it takes those that see a point of it"


def _job(
    place: Ground,
    found: Partition,
    block: int,
    settings: Settings,
    run: Run,
    cache: Path,
    *,
    views: Bool[Tensor, " v"],
    note: str,
    auxiliary: Auxiliary,
    follow: bool,
    surrounding: Surrounding,
    sampling: SamplingSettings | None,
    coarse: Path | None,
    side: SideSettings,
    weights: str,
    terms: BlockTerms,
    planted: PlantSettings,
    start: Start,
    roles: Int8[Tensor, " m"] | None,
) -> BlockJob:
    scene = place.scene
    own = found.labels == block
    of_points = point_roles(
        place, found, block, views, auxiliary=auxiliary, surrounding=surrounding
    )
    kept = of_points[of_points != LEFT_OUT] if roles is None else roles
    held = (of_points if roles is None else roles) != LEFT_OUT
    work = block_work(scene, views, start, held, steps=settings.iterations)
    sides: tuple[Camera, ...] = ()
    if side.every:
        alone = torch.where(own, 0, LEFT_OUT).to(of_points)
        sides = side_cameras(block_scene(scene, views, alone), side)
    if planted != NO_PLANT:
        wrong = planted_views(scene, planted, block, len(found.regions), place.frame)
        scene = replace(scene, views=wrong)
    job = BlockJob(
        scene=block_scene(scene, views, of_points), settings=settings, planted=planted, sides=sides, side=side, weights=weights,
        block_terms=terms, roles=kept,
        facts=BlockFacts(block=block, views=int(views.sum()), points=int(own.sum()),
                         load=int(place.loads[own].sum()), steps=settings.iterations, note=note,
                         pixels=work.pixels, pairs=work.pairs, gaussians=work.gaussians),
        folder=cache, centre=found.regions[block].centre, frame=place.frame, sampling=sampling,
        follow=follow, start=coarse, seed=run.seed + SEEDS_APART * block, backend=run.backend,
        background=run.background, checkpoint_seconds=run.checkpoint_seconds,
        image_bytes=max(run.image_bytes // run.workers, 1),
    )  # fmt: skip
    return replace(job, folder=cache / job.key[:16])


def point_roles(
    place: Ground,
    found: Partition,
    block: int,
    views: Bool[Tensor, " v"],
    *,
    auxiliary: Auxiliary,
    surrounding: Surrounding,
) -> Int8[Tensor, " n"]:
    """Role of each sparse point of the scene in one block.

    Args:
        place: The whole scene.
        found: Its partition.
        block: Number of the block.
        views: Views that it trains on.
        auxiliary: What takes part beside the block's own points.
        surrounding: Where ghosts are taken from.
    """
    points, near = place.scene.points, None
    if surrounding == "region" and auxiliary in ("ghosts", "both"):
        near = found.regions[block].distance(points.positions) <= 1 + RIM
    return roles_of(
        points, found.points[block], views, found.labels, block, place.positions, auxiliary, near
    )


def block_scene(scene: Scene, views: Bool[Tensor, " v"], roles: Int8[Tensor, " n"]) -> Scene:
    """The scene of one block: its views, all for training, and the points that have a role.

    Args:
        scene: The whole scene.
        views: Which of its views the block has.
        roles: Role of each of its sparse points; those that are LEFT_OUT are not in the block's scene.
    """
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
