"""Making a world that is killed goes on where it was and gives the same bytes."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from splatproof.datasets.procedural import exporting

pytestmark = pytest.mark.slow
KILLED_AT = {"courtyard": 4, "city": 5, "aerial-sparse": 7, "tunnel": 30, "street": 9}
"""Steps done when the process dies: views for most, all of them and some points for the tunnel."""
CHILD = """
import os, signal, sys
from pathlib import Path
import torch
from helpers import tiny_worlds
from splatproof.datasets.procedural import exporting

torch.set_num_threads(1)
world, step = sys.argv[2], int(sys.argv[3])

def die(done, total):
    if done >= step:
        os.kill(os.getpid(), signal.SIGKILL)

exporting.make_scene(tiny_worlds.plan(world), Path(sys.argv[1]) / world, die)
"""


def kill(root, world):
    """Begin to make a world in a folder, and be killed."""
    step = str(KILLED_AT[world])
    paths = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    arguments = [sys.executable, "-c", CHILD, str(root), world, step]
    assert subprocess.run(arguments, check=False, env=environment).returncode == -signal.SIGKILL


def contents(folder):
    """Bytes of every file of a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.parametrize(
    "world",
    # all go through one exporter; the fastest stands for them
    [w if w == "city" else pytest.param(w, marks=pytest.mark.slow) for w in KILLED_AT],
)
def test_a_killed_world_goes_on_and_has_the_bytes_of_an_undisturbed_one(tmp_path, made, world):
    whole, plan = made(world)
    killed = tmp_path
    kill(killed, world)
    assert not (killed / world).exists()
    (work,) = killed.glob(f".{world}*")
    (work / "photos").mkdir(exist_ok=True)
    (work / "photos" / "view.png.77.partial").write_bytes(b"of a kill in the middle of a file")
    told = []
    exporting.make_scene(plan, killed / world, lambda done, total: told.append(done))
    # a view is counted once it is whole; those in work, one a worker, may be whole too
    kept = min(KILLED_AT[world], len(plan.shots))
    assert kept <= told[0] <= kept + exporting.WORKERS
    found, wanted = contents(killed / world), contents(whole)
    assert found.keys() == wanted.keys()
    assert [name for name in wanted if found[name] != wanted[name]] == []
    assert not list(killed.glob(f".{world}*"))
