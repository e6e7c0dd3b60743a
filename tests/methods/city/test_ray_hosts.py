"""Blocks on a cluster of four hosts with a network between them, one of which is lost in mid-block."""

import os
import re
import secrets
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
import torch

from helpers.baking import baked
from helpers.blocks_on_ray import BLOCKS, jobs
from helpers.network_hosts import Host, hosts, unavailable
from splatproof.methods.city.train_block import BlockJob
from splatproof.methods.loading import load_reconstruction

pytest.importorskip("ray", reason="ray is not installed: pip install -e '.[distributed]'")
pytestmark = pytest.mark.slow

STEPS = 20_000
"""Some ten seconds of a block: long enough for the loss of its host in the middle, on a busy machine too."""
PROGRAM = (sys.executable, "-m", "helpers.blocks_on_ray")
PATIENCE = 300.0
"""Seconds after which a cluster that does not end has failed."""
SOON = {
    "RAY_health_check_initial_delay_ms": "1000", "RAY_health_check_period_ms": "1000",
    "RAY_health_check_timeout_ms": "2000", "RAY_health_check_failure_threshold": "3",
}  # fmt: skip
"""Ray gives a host that says nothing up after seconds instead of most of a minute."""


@pytest.fixture(scope="module", autouse=True)
def network() -> None:
    """Skip where no hosts can be made."""
    if why := unavailable():
        pytest.skip(why)


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same blocks where nothing was lost, trained in a process without the checks of shapes that tests have."""
    folder = tmp_path_factory.mktemp("straight")
    env = {**os.environ, "PYTHONPATH": "tests", "OMP_NUM_THREADS": "1"}
    subprocess.run(
        [*PROGRAM, str(folder), str(STEPS)], check=True, env=env, stdout=subprocess.DEVNULL
    )
    return folder


@pytest.fixture
def sockets() -> Iterator[Path]:
    """A folder of a short name: Ray's sockets lie in it."""
    path = Path(tempfile.mkdtemp(prefix="ray", dir="/tmp"))
    yield path
    shutil.rmtree(path, ignore_errors=True)


def start(made: list[Host], sockets: Path, log: Path) -> dict[str, str]:
    """Ray on every host, a processor each.

    Args:
        made: The hosts; the first is the cluster's head.
        sockets: Folder for its sockets.
        log: Where it writes.

    Returns: Variables of a program that uses the cluster.
    """
    ray = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block", "--num-cpus=1",
           "--object-store-memory=80000000", "--disable-usage-stats"]  # fmt: skip
    address = f"{made[0].address}:6379"
    secret = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    for host in made:
        place = [f"--node-ip-address={host.address}", f"--temp-dir={sockets / host.name}"]
        if host is made[0]:
            place += ["--head", "--port=6379", "--include-dashboard=false"]
        else:
            place += [f"--address={address}"]
        host.start([*ray, *place], log, SOON | secret)
    return {"RAY_ADDRESS": address, "PYTHONPATH": "tests", **secret}


def steps(log: Path) -> list[tuple[int, int]]:
    """What the driver has been told so far: (block, step)."""
    told = log.read_text() if log.exists() else ""
    return [(int(a), int(b)) for a, b in re.findall(r"^at (\d+) (\d+)$", told, re.MULTILINE)]


def blocks_of(host: Host, trained: Sequence[BlockJob]) -> list[int]:
    """Numbers of the blocks whose lock a process of the host has open: it trains them."""
    found = set()
    for pid in host.processes():
        try:
            found |= {os.readlink(fd) for fd in Path(f"/proc/{pid}/fd").iterdir()}
        except OSError:  # it ended, or closed one, while it was looked at
            continue
    return [n for n, job in enumerate(trained) if str(job.folder / ".worker") in found]


def means(job: BlockJob) -> torch.Tensor:
    return baked(load_reconstruction(job.model)).means


@pytest.mark.parametrize("lose", [Host.cut, Host.end], ids=["cut off", "without power"])
def test_nothing_is_lost_with_a_host(tmp_path, straight, sockets, lose: Callable[[Host], None]):
    log, noise = tmp_path / "driver.log", tmp_path / "ray.log"
    trained = jobs(tmp_path / "run", STEPS)
    with hosts(4) as made:
        env = start(made, sockets, noise)
        driver = made[0].start([*PROGRAM, str(tmp_path / "run"), str(STEPS)], log, env)
        ends, lost = time.monotonic() + PATIENCE, False
        while driver.poll() is None and time.monotonic() < ends:
            time.sleep(0.1)
            reached = dict(sorted(steps(log)))
            for host in made[1:]:
                inside = [reached.get(n, 0) for n in blocks_of(host, trained)]
                if not lost and any(STEPS // 10 <= step < STEPS // 2 for step in inside):
                    lose(host)
                    lost = True
        assert driver.poll() == 0, log.read_text()[-2000:] + noise.read_text()[-2000:]
    assert lost  # in the first half of its block
    assert "blocks 0 1 2 3" in log.read_text()
    again = Counter(steps(log))
    assert all(again[block, 10] == 1 for block in range(BLOCKS))  # none began anew
    for one, other in zip(jobs(straight, STEPS), trained, strict=True):
        assert torch.equal(means(one), means(other))
