"""How evenly work is spread over blocks. (The edge cut is splatproof.reference.partition.metis.cut_size.)"""

import heapq
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from splatproof.base.errors import DataError


def spread(loads: Float[np.ndarray, " k"]) -> tuple[float, float]:
    """(std / mean, max / mean) of the blocks' loads, seconds or views.

    The standard deviation is that of these blocks (divided by k, not k - 1): they are all there are.

    Args:
        loads: One number >= 0 a block, any unit; empty blocks count with 0.
    Returns: 0 and 1 for equal loads; sqrt(k - 1) and k where one block has all.
    Raises: DataError without blocks, without load, or on a load that is negative or not finite.
    Source: ours.
    """
    if len(loads) == 0:
        raise DataError("balance: no blocks were given")
    bad = np.flatnonzero(~(np.isfinite(loads) & (loads >= 0)))
    if len(bad):
        raise DataError(f"balance: block {bad[0]} has the load {loads[bad[0]]:g}, expected >= 0")
    mean = loads.mean()
    if mean == 0:
        raise DataError(f"balance: all {len(loads)} blocks have no load")
    return float(loads.std() / mean), float(loads.max() / mean)


def makespan(times: Sequence[float], workers: int) -> float:
    """When the last job ends if each worker, once free, takes the next of the list.

    Args:
        times: Seconds of each job, in the order in which they are handed out.
        workers: Number of workers.
    Returns: Seconds from the start of the first job to the end of the last.
    """
    free = [0.0] * min(workers, len(times))  # who never gets a job never ends one
    for time in times:
        heapq.heappush(free, heapq.heappop(free) + time)
    return max(free, default=0.0)
