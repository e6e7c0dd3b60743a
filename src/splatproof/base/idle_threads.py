"""How the threads of libraries wait for each other; read when a library is first loaded."""

import os

ASLEEP = {
    # torch: threads that spin while they wait make training ten times slower on a machine that is shared
    "OMP_WAIT_POLICY": "PASSIVE",
    # numpy and scipy solve many tiny systems here and no large ones. With a thread a core each of them is a
    # wait in a loop: scoring the stitched rows of suite city-quick took 573 s beside one other busy process,
    # and 19 s with one thread (one after the other, two cores).
    "OPENBLAS_NUM_THREADS": "1",
}
"""Variables of the environment; what a user has set stays."""


def wait_asleep() -> None:
    """Let libraries that this process, and those that it starts, load from now on leave cores to others."""
    for name, value in ASLEEP.items():
        os.environ.setdefault(name, value)
