"""Memory that training the blocks will take, before anything has started."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from splatproof.base.errors import MissingError
from splatproof.base.memory import available_mb
from splatproof.methods.city.point_roles import LEFT_OUT, OWN
from splatproof.methods.city.train_block import BlockJob
from splatproof.methods.threedgs.cost import PROCESS_MB, image_bytes, training_memory_mb

GROWTH = 8.0
"""Gaussians at the end for each point at the start, unless `density.most` says fewer."""
GROWTH_OF_COARSE = 2.0
"""Gaussians at the end for each of a coarse model's at the start, likewise."""


@dataclass(frozen=True, kw_only=True)
class MemoryPlan:
    """Estimated peak memory in 2^20 bytes."""

    blocks: tuple[float, ...]
    """Estimate for the process of each block."""
    workers: int
    """Number of blocks that are trained at once."""
    available: float
    """What the machine has left."""

    @property
    def total(self) -> float:
        """Sum over the fullest blocks, as many as are trained at once."""
        return sum(sorted(self.blocks, reverse=True)[: self.workers])

    @property
    def text(self) -> str:
        """The plan in one line."""
        each = ", ".join(f"{block:.0f}" for block in self.blocks)
        return (
            f"memory: {len(self.blocks)} blocks of about {each} MB, {self.workers} at once; "
            f"{self.available:.0f} MB are free"
        )

    @property
    def enough(self) -> int:
        """Smallest number of blocks that would fit, if work divides evenly; 0 if none would."""
        each = self.available / self.workers - PROCESS_MB
        if each <= 0:
            return 0
        return math.ceil(len(self.blocks) * (max(self.blocks) - PROCESS_MB) / each)


def block_memory_mb(job: BlockJob) -> float:
    """Estimated peak memory of one block in 2^20 bytes, from the points it starts with.

    Args:
        job: The block; no image is read.
    """
    cameras = [view.camera for view in job.scene.views]
    pixels = [camera.width * camera.height for camera in cameras]
    own, taken = int((job.roles == OWN).sum()), int((job.roles != LEFT_OUT).sum())
    growth = GROWTH if job.start is None else GROWTH_OF_COARSE
    count = taken - own + growth * own
    if job.settings.density.most is not None:
        count = min(count, max(job.settings.density.most, taken))
    return training_memory_mb(
        float(count), image_bytes=image_bytes(cameras, job.image_bytes),
        pixels=float(max(pixels, default=0)), sh_degree=job.settings.sh_degree,
    )  # fmt: skip


def plan_memory(jobs: Sequence[BlockJob], workers: int) -> MemoryPlan:
    """Estimate all blocks and refuse what cannot fit.

    Args:
        jobs: One a block, at least one.
        workers: Most blocks that are trained at once, at least 1.

    Raises: MissingError, with the number of blocks that would fit.
    """
    plan = MemoryPlan(
        blocks=tuple(block_memory_mb(job) for job in jobs),
        workers=min(workers, len(jobs)),
        available=available_mb(),
    )
    if plan.total > plan.available:
        fewer = f"use fewer workers than {plan.workers}" if plan.workers > 1 else ""
        more = f"ask for at least {plan.enough} blocks" if plan.enough > len(jobs) else ""
        advice = " or ".join(part for part in (more, fewer) if part) or "use smaller images"
        raise MissingError(
            f"training {plan.workers} of {len(jobs)} blocks at once takes about {plan.total:.0f} MB, "
            f"{plan.available:.0f} MB are free; {advice}"
        )
    return plan
