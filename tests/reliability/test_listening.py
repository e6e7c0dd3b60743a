"""Nothing that the project starts can be reached from another machine."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from helpers.colmap_scenes import Flight, write_scene
from helpers.listeners import listeners, reachable
from helpers.talking_workers import echo
from helpers.tiny_scene import random_gaussians
from splatproof.base.local_server import listening
from splatproof.base.processes import Worker
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reports.mlflow_client import default_uri, open_client
from splatproof.viewing.live import watched

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/proc/net is Linux's")
BENCH = str(Path(sys.executable).with_name("bench"))


@pytest.mark.parametrize(
    ("kind", "host", "found"),
    [
        (socket.SOCK_STREAM, "0.0.0.0", True),
        (socket.SOCK_STREAM, "::", True),
        (socket.SOCK_DGRAM, "0.0.0.0", True),
        (socket.SOCK_STREAM, "127.0.0.1", False),
        (socket.SOCK_STREAM, "::1", False),
    ],
)
def test_what_could_be_reached_is_found(kind, host, found):
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, kind) as one:
        try:
            one.bind((host, 0))
        except OSError:
            pytest.skip(f"this machine has no {host}")
        if kind == socket.SOCK_STREAM:
            one.listen()
        at = f"{host}:{one.getsockname()[1]}"
        assert any(name.endswith(f" {at}") for name in listeners(os.getpid()))
        assert any(name.endswith(f" {at}") for name in reachable(os.getpid())) is found


@pytest.mark.parametrize("preload", [(), ("splatproof.base.errors",)])
def test_workers_and_a_page_listen_to_this_machine_alone(preload):
    with listening(0) as at, Worker(echo, "hello", preload=preload) as worker:
        worker.receive()
        assert f"tcp 127.0.0.1:{at.getsockname()[1]}" in listeners(os.getpid())
        assert reachable(os.getpid()) == {}


def test_a_fit_that_is_watched_listens_to_this_machine_alone(tmp_path):
    write_scene(tmp_path / "town", Flight(views=3, points=12))
    said: list[str] = []
    with watched(str(tmp_path / "town"), load_protocol("default"), "3dgs", said.append):
        port = said[0].rstrip("/").rpartition(":")[2]
        assert f"tcp 127.0.0.1:{port}" in listeners(os.getpid())
        assert reachable(os.getpid()) == {}


@contextmanager
def serving(*arguments: str, folder: Path) -> Iterator[tuple[int, str]]:
    """A command that serves: its process and the address that it says."""
    with subprocess.Popen(
        [BENCH, *arguments, "--port", "0", "--json"], cwd=folder, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            yield process.pid, json.loads(process.stdout.readline())["address"]
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["view", "dashboard"])
def test_pages_listen_to_this_machine_alone(tmp_path, command):
    save_model(ExplicitModel(model=random_gaussians(50)), tmp_path / "model", Origin())
    (tmp_path / "runs").mkdir()
    open_client(default_uri(tmp_path / "runs"))  # makes an empty store
    arguments = ["view", "model"] if command == "view" else ["dashboard", "--out", "runs"]
    with serving(*arguments, folder=tmp_path) as (process, address):
        assert f"tcp {address.split('//')[1].rstrip('/')}" in listeners(process)
        assert reachable(process) == {}


CLUSTER = """
import json, os
from pathlib import Path
from helpers.city_scene import small_scene
from helpers.listeners import listeners, reachable
from splatproof.methods.city.executor import run_blocks
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings

scene, run = small_scene(60), Run(backend="cpu", threads=1, checkpoint_seconds=0.0)
found = partition(scene, 2, PartitionSettings(margin=0.1))
jobs = block_jobs(scene, found, Settings(iterations=20, sh_degree=0), run, Path("run"))
seen = []

def report(*_):
    if not seen:
        seen.extend([listeners(os.getpid()), reachable(os.getpid())])

run_blocks(jobs[:1], engine="ray", workers=1, threads=1, report=report)
print(json.dumps(seen))
"""
"""In a process of its own: Ray's first import decides."""


@pytest.mark.slow
def test_a_cluster_of_one_machine_listens_to_it_alone(tmp_path):
    pytest.importorskip("ray", reason="ray is not installed: pip install -e '.[distributed]'")
    given = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    said = subprocess.run(
        [sys.executable, "-c", CLUSTER], cwd=tmp_path, capture_output=True, text=True, check=True,
        env=given | {"PYTHONPATH": str(Path(__file__).parents[1])},
    ).stdout  # fmt: skip
    seen, reached = json.loads(said.splitlines()[-1])
    assert len(seen) > 3  # Ray's processes do listen
    assert reached == {}
