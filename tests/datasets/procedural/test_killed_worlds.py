"""Making a world that is killed goes on where it was and gives the same bytes."""

import os
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
for world, step in zip(sys.argv[2::2], map(int, sys.argv[3::2])):
    child = os.fork()
    if child == 0:
        def die(done, total):
            if done >= step:
                os.kill(os.getpid(), signal.SIGKILL)
        exporting.make_scene(tiny_worlds.plan(world), Path(sys.argv[1]) / world, die)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A folder in which making each world was killed."""
    root = tmp_path_factory.mktemp("killed")
    steps = [str(word) for pair in KILLED_AT.items() for word in pair]
    paths = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    subprocess.run([sys.executable, "-c", CHILD, str(root), *steps], check=True, env=environment)
    return root


def contents(folder):
    """Bytes of every file of a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.parametrize("world", KILLED_AT)
def test_a_killed_world_goes_on_and_has_the_bytes_of_an_undisturbed_one(killed, made, world):
    whole, plan = made(world)
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
