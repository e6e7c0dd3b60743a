"""What a city costs before it is built: blocks, memory, wall time on n machines, where it stops scaling."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatproof.base.errors import UsageError
from splatproof.base.numbers import in_range
from splatproof.methods.city.cost import START_SECONDS
from splatproof.methods.threedgs.cost import (
    GAUSSIAN_STEP,
    IMAGE_BYTES,
    PIXEL_STEP,
    training_memory_mb,
)
from splatproof.metrics.balance import makespan

STITCH_SECONDS = 0.6e-6
"""CPU seconds a primitive of stitching. Measured like the next two: 800,000 Gaussians of degree 3 in
four blocks, one thread at 2.6 GHz, process time."""
MERGE_SECONDS = 0.6e-6
"""CPU seconds a primitive of writing the merged model."""
PACK_SECONDS = 1.8e-6
"""CPU seconds a primitive of packing (200,000 Gaussians, one thread)."""
SPREAD = 0.2
"""Standard deviation of the logarithm of block times that is assumed, unless --spread says otherwise;
docs/city.md has what was measured (time std/mean)."""
MOST = 10**12
"""Largest number of anything that is planned; the sums stay whole in float64."""
MOST_SIMULATED = 100_000
"""Blocks of the largest city that is simulated: DRAWS such runs take 7 s at 2.6 GHz."""
DRAWS = 50
"""Simulated runs whose mean and extremes are told."""


@dataclass(frozen=True, kw_only=True)
class City:
    """What is to be built, and on what."""

    views: int = 10_000
    """Number of training views."""
    gaussians: int = 100_000_000
    """Number of Gaussians in the finished model."""
    pixels: int = 1_600 * 1_200
    """Number of pixels of a view."""
    iterations: int = 30_000
    """Training steps of each block."""
    refinement: int = 7_000
    """Training steps over the merged model; 0: it is not refined."""
    margin: float = 0.15
    """Share of its own size by which a block is widened while it trains."""
    views_a_block: float = 2.5
    """Blocks that a view is trained by, on average (2 to 3 in the partition study at K = 4 to 8)."""
    cores: int = 16
    """Number of cores of a machine."""
    memory_gb: float = 64.0
    """Memory of a machine, in 2^30 bytes."""
    image_bytes: int = 2**30
    """Bytes of training images that a worker keeps in memory."""

    def __post_init__(self) -> None:
        """Refuse numbers that no city can have."""
        for name in ("views", "gaussians", "pixels", "iterations", "cores"):
            in_range(getattr(self, name), f"--{name}", 1, MOST)
        for name in ("margin", "refinement"):
            in_range(getattr(self, name), f"--{name}", 0, MOST)
        for name in ("memory_gb", "views_a_block"):
            in_range(getattr(self, name), f"--{name.replace('_', '-')}", 0, MOST, above=True)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One number of blocks on one number of machines."""

    blocks: int
    """Number of blocks."""
    machines: int
    """Number of machines."""
    workers: int
    """Blocks that a machine trains at once; 0: not even one fits."""
    block_memory_mb: float
    """Peak memory of one block's process, in 2^20 bytes."""
    block_seconds: float
    """Wall seconds of one block with its share of a machine's cores."""
    blocks_seconds: float
    """Wall seconds of all blocks."""
    serial_seconds: float
    """Wall seconds of what one machine does alone: stitching, merging, refining, packing."""
    refine_memory_mb: float
    """Peak memory of refining in 2^20 bytes; it holds the whole model, so where this is more than a
    machine has it cannot be done there."""

    @property
    def seconds(self) -> float:
        """Wall seconds of everything."""
        return self.blocks_seconds + self.serial_seconds


def block_gaussians(city: City, blocks: int) -> float:
    """Gaussians of a block at the end: its share of the city, widened on two axes by the margin.

    Args:
        city: What is built.
        blocks: Number of blocks of equal size.
    """
    grown = (1 + city.margin) ** 2 if blocks > 1 else 1.0
    return float(min(city.gaussians, city.gaussians / blocks * grown))


def block_memory(city: City, blocks: int) -> float:
    """Peak memory of a block's process in 2^20 bytes, by the pipeline's own estimate.

    Args:
        city: What is built.
        blocks: Number of blocks of equal size.
    """
    views = city.views * min(1.0, city.views_a_block / blocks)
    return _memory(city, block_gaussians(city, blocks), views)


def block_cpu_seconds(city: City, blocks: int) -> float:
    """CPU seconds of a block: iterations x (pixels a + Gaussians b), half of the final Gaussians.

    Args:
        city: What is built.
        blocks: Number of blocks of equal size.
    """
    step = city.pixels * PIXEL_STEP + block_gaussians(city, blocks) / 2 * GAUSSIAN_STEP
    return START_SECONDS + city.iterations * step


def serial_cpu_seconds(city: City) -> float:
    """CPU seconds of stitching, merging, refining and packing the whole city."""
    rows = city.gaussians * (STITCH_SECONDS + MERGE_SECONDS + PACK_SECONDS)
    step = city.pixels * PIXEL_STEP + city.gaussians * GAUSSIAN_STEP
    return rows + city.refinement * step


def plan(city: City, blocks: int, machines: int) -> Plan:
    """Plan for K blocks of equal size on n machines.

    Args:
        city: What is built.
        blocks: Number of blocks K, at least 1.
        machines: Number of machines n, at least 1.
    Returns: Memory and wall seconds, infinite where not even one block fits into a machine.
    Raises: UsageError for fewer than one of either, or more than MOST.
    """
    in_range(blocks, "--blocks", 1, MOST)
    in_range(machines, "--machines", 1, MOST)
    memory, room = block_memory(city, blocks), city.memory_gb * 1024
    workers = min(city.cores, int(room / memory), -(-blocks // machines))
    seconds = waves = math.inf
    if workers:
        seconds = block_cpu_seconds(city, blocks) / (city.cores / workers)
        waves = -(-blocks // (workers * machines))
    return Plan(
        blocks=blocks, machines=machines, workers=workers, block_memory_mb=memory,
        block_seconds=seconds, blocks_seconds=seconds * waves,
        serial_seconds=serial_cpu_seconds(city) / city.cores,
        refine_memory_mb=_refine_memory(city),
    )  # fmt: skip


def _refine_memory(city: City) -> float:
    """Memory of refining in 2^20 bytes: a trainer holds all Gaussians at once; 0 without it."""
    if not city.refinement:
        return 0.0
    return _memory(city, float(city.gaussians), float(city.views))


def _memory(city: City, gaussians: float, views: float) -> float:
    """The pipeline's own estimate of a training process."""
    return training_memory_mb(
        gaussians, pixels=float(city.pixels),
        image_bytes=min(float(city.image_bytes), IMAGE_BYTES * city.pixels * views),
    )  # fmt: skip


def fewest_blocks(city: City) -> int:
    """Smallest K of which a block fits into a machine's memory."""
    room = city.memory_gb * 1024
    least = block_memory(city, city.gaussians)
    if least > room:
        raise UsageError(f"--memory-gb {city.memory_gb:g}: a process without Gaussians takes "
                         f"{least / 1024:.1f}; use larger machines or smaller views")  # fmt: skip
    low, high = 1, city.gaussians
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if block_memory(city, middle) <= room else (middle + 1, high)
    return low


def most_useful_blocks(city: City) -> int:
    """K beyond which more than half of a block's work is its pixels, which more blocks only repeat."""
    each = city.gaussians * (1 + city.margin) ** 2 / 2 * GAUSSIAN_STEP
    return max(1, round(each / (city.pixels * PIXEL_STEP)))


def most_useful_machines(city: City, blocks: int) -> int:
    """Number of machines at which what one machine does alone takes as long as all blocks.

    From there on more machines halve nothing.

    Args:
        city: What is built.
        blocks: Number of blocks of equal size.
    Returns: At most one machine a block; 0 where not even one block fits into a machine.
    """
    one = plan(city, blocks, 1)
    if not one.workers:
        return 0
    total = blocks * block_cpu_seconds(city, blocks) / city.cores
    return max(1, min(blocks, round(total / max(one.serial_seconds, 1e-9))))


def recommended(city: City, blocks: Sequence[int], machines: Sequence[int]) -> Plan:
    """The plan with the least wall time among those whose machines still help; of equals the cheapest.

    Args:
        city: What is built.
        blocks: Numbers of blocks to choose from.
        machines: Numbers of machines to choose from; of those that are too many for a number of blocks
            the smallest counts, where no other is left.
    Returns: One plan; its seconds are infinite where no block fits anywhere.
    """
    found = []
    for count in blocks:
        useful = most_useful_machines(city, count)
        sensible = [number for number in machines if number <= useful] or [min(machines)]
        found += [plan(city, count, number) for number in sensible]
    return min(found, key=lambda one: (one.seconds, one.machines, one.blocks))


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """Block stages of DRAWS simulated runs, in wall seconds."""

    mean: float
    """Mean over the runs."""
    fastest: float
    """Seconds of the fastest run."""
    slowest: float
    """Seconds of the slowest run."""
    busy: float
    """Share of the workers' time in which they train, on average."""


def simulate(found: Plan, spread: float, seed: int) -> Simulated:
    """Blocks of unequal times on the plan's workers: each free worker takes the longest that waits.

    Times are the plan's, times exp(spread N(0, 1) - spread^2 / 2): their mean stays.

    Args:
        found: Plan with at least one worker a machine.
        spread: Standard deviation of the logarithm of block times, 0 to 10.
        seed: Number that the draws depend on.
    Returns: Mean and extremes of the wall seconds of DRAWS runs.
    Raises: UsageError for another spread, a negative seed, or more than MOST_SIMULATED blocks.
    Source: list scheduling by longest first, Graham 1969.
    """
    in_range(spread, "--spread", 0, 10)
    in_range(seed, "--seed")
    in_range(found.blocks, "--simulate: the number of blocks", 1, MOST_SIMULATED)
    rng = np.random.default_rng(seed)
    ends, busy = [], []
    slots = found.workers * found.machines
    for _ in range(DRAWS):
        noise = rng.normal(size=found.blocks) * spread - spread**2 / 2
        times = sorted((found.block_seconds * np.exp(noise)).tolist(), reverse=True)
        end = makespan(times, slots)
        ends.append(end)
        busy.append(sum(times) / (end * min(slots, found.blocks)))
    return Simulated(mean=statistics.fmean(ends), fastest=min(ends), slowest=max(ends),
                     busy=statistics.fmean(busy))  # fmt: skip
