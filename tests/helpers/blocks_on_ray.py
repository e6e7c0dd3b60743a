"""Four small blocks, trained on the cluster that RAY_ADDRESS names, or in this process without one.

python -m helpers.blocks_on_ray FOLDER STEPS
"""

import os
import sys
import time
from pathlib import Path

from helpers.city_scene import small_scene
from splatproof.methods.city.executor import run_blocks
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.city.train_block import BlockJob
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density

BLOCKS = 4


def jobs(folder: Path, steps: int) -> tuple[BlockJob, ...]:
    """The blocks, with five checkpoints a second.

    Args:
        folder: Where they go.
        steps: Steps of each.
    """
    scene = small_scene(240)
    settings = Settings(iterations=steps, sh_degree=0, density=Density(stop=0))
    found = partition(scene, BLOCKS, PartitionSettings(margin=0.1))
    run = Run(backend="cpu", threads=1, checkpoint_seconds=0.2)
    return block_jobs(scene, found, settings, run, folder)


def wait_for_all(address: str) -> None:
    """Join the cluster, and wait until it has a processor for each block.

    Args:
        address: Its head's.
    """
    import ray

    ray.init(address=address, log_to_driver=False, configure_logging=False)
    while ray.cluster_resources().get("CPU", 0) < BLOCKS:
        time.sleep(0.2)


def tell(index: int, step: int, total: int, values: dict[str, float]) -> None:
    print("at", index, step, flush=True)


if __name__ == "__main__":
    head = os.environ.get("RAY_ADDRESS")
    if head:
        wait_for_all(head)
    found = run_blocks(
        jobs(Path(sys.argv[1]), int(sys.argv[2])),
        engine="ray" if head else "inline", workers=BLOCKS, threads=BLOCKS, report=tell,
    )  # fmt: skip
    print("blocks", *(facts.block for facts in found), flush=True)
