"""Settings that all tests share."""

import gc
import os
import signal

from splatproof.base.idle_threads import wait_asleep

# No garbage is looked for while modules and tests are imported and collected: a quarter of that time.
gc.disable()

# Before torch and numpy are imported, for these and for the processes that tests start. Threads that wait in a
# loop for each other burn the cores that others need: beside other work three tests of the kernels
# took 109 s that way and take 14 s when threads sleep. Under pytest-xdist a worker has one thread.
wait_asleep()
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ["OMP_NUM_THREADS"] = "1"

# Before our rooms are imported, so that their functions are made so.
from helpers.sampled_types import count_from_zero, sample_types

sample_types()

import pytest
import torch
from hypothesis import HealthCheck, settings

# This machine may be shared, so time is no reason to fail; CI draws the same examples each run,
# and fewer of them.
settings.register_profile(
    "splatproof",
    deadline=None,
    derandomize=bool(os.environ.get("CI")),
    max_examples=30 if os.environ.get("CI") else 100,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("splatproof")

# Some of torch's warnings come once a process: then the order of tests decides which one fails.
torch.set_warn_always(True)

# A script's job in the background is started deaf to Ctrl-C, and so would be all that tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

LONGEST = (
    "suites/test_reduced_suites.py",
    "suites/test_reduced_unseen.py",
    "suites/test_reduced_street.py",
    "suites/test_reduced_sparse.py",
    "suites/test_reduced_tunnel.py",
    "torture/test_torture.py",
    "fuzz/test_inputs.py",
    "plugins/test_third_party.py",
    "regression/test_regression.py",
)
"""Files of minutes: begun last, they would leave the other workers idle at the end."""


def pytest_xdist_auto_num_workers() -> int:
    """Two workers more than cores: some tests wait for a clock or for a process of theirs."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return cores + 2


def pytest_runtest_setup() -> None:
    """Which calls have their types checked depends on the test alone."""
    count_from_zero()


def pytest_collection_finish() -> None:
    """Modules and tests are no garbage: not to be looked at at each later search."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files."""

    def turn(item: pytest.Item) -> int:
        path = item.path.as_posix()
        return next((n for n, end in enumerate(LONGEST) if path.endswith(end)), len(LONGEST))

    items.sort(key=turn)
