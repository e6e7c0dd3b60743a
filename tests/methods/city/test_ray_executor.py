"""Blocks on a local cluster of two workers, one of which is killed in mid-block."""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from helpers.baking import baked
from helpers.city_scene import small_scene
from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError, MissingError
from splatproof.base.plugin_files import load_plugin_file
from splatproof.methods.city import ray_executor
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.executor import run_blocks
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.city.refine import RefineSettings
from splatproof.methods.city.refine_parts import Whole, mean_of_parts, part_jobs, refine_parts
from splatproof.methods.city.train_block import BlockJob
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density

STEPS = 300
SETTINGS = Settings(iterations=STEPS, sh_degree=0, density=Density(stop=0))


def jobs(folder: Path, settings: Settings = SETTINGS) -> tuple[BlockJob, ...]:
    scene = small_scene(60)
    run = Run(backend="cpu", threads=1, checkpoint_seconds=0.0)
    found = partition(scene, 2, PartitionSettings(margin=0.1))
    return block_jobs(scene, found, settings, run, folder)


def nothing(*_: object) -> None: ...


def means(job: BlockJob):
    return baked(load_reconstruction(job.model)).means


@pytest.fixture(scope="module")
def cluster():
    """Two CPUs: two workers of a thread each."""
    ray = pytest.importorskip("ray", reason="ray is not installed: pip install -e '.[distributed]'")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    yield ray
    ray.shutdown()


def parent(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("PPid:")), 0)


def busy_workers() -> list[int]:
    """Processes below this one that train a block now; ray names a worker after its task."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        pid = int(path.parent.name)
        try:
            name = path.read_bytes()
        except OSError:
            continue
        above = pid
        while above > 1 and above != os.getpid():
            above = parent(above)
        if name.startswith(b"ray::train_remotely") and above == os.getpid():
            found.append(pid)
    return sorted(found)


@pytest.mark.slow  # tests/methods/city/test_executor.py kills those of our own processes
def test_a_block_whose_worker_is_killed_goes_on_elsewhere_from_its_checkpoint(tmp_path, cluster):
    straight, killed = jobs(tmp_path / "straight"), jobs(tmp_path / "killed")
    run_blocks(straight, engine="inline", threads=1, report=nothing)
    heard: list[tuple[int, int]] = []
    victims: list[int] = []

    def report(index: int, step: int, total: int, values: dict[str, float]) -> None:
        heard.append((index, step))
        if not victims and 20 <= step < STEPS / 2 and busy_workers():
            victims.append(busy_workers()[0])
            os.kill(victims[0], signal.SIGKILL)

    facts = run_blocks(killed, engine="ray", workers=2, threads=2, report=report)
    assert victims
    assert [one.block for one in facts] == [0, 1]
    assert all(one.seconds > 0 for one in facts)
    assert {(0, STEPS), (1, STEPS)} <= set(heard)
    for index in (0, 1):  # from a checkpoint, not from the start again
        assert [step for i, step in heard if i == index].count(10) <= 1
    for one, other in zip(straight, killed, strict=True):
        assert torch.equal(means(one), means(other))


PLUGIN = """
from dataclasses import dataclass
from typing import Any

@dataclass(frozen=True)
class Photo:
    load: Any

    def __call__(self):
        return self.load()
"""


@pytest.mark.slow  # another worker with all imports: 20 s
@pytest.mark.usefixtures("cluster")
def test_a_worker_loads_the_plug_in_whose_classes_a_job_is_made_of(tmp_path):
    (tmp_path / "photo_source.py").write_text(PLUGIN)
    photo = load_plugin_file(tmp_path / "photo_source.py").module.Photo
    job = jobs(tmp_path / "run", replace(SETTINGS, iterations=5))[0]
    views = tuple(replace(view, load=photo(view.load)) for view in job.scene.views)
    job = replace(job, scene=replace(job.scene, views=views))
    (facts,) = run_blocks([job], engine="ray", threads=1, report=nothing)
    assert facts.block == 0


@pytest.mark.usefixtures("cluster")
def test_parts_of_a_refinement_are_the_same_on_the_cluster_as_here(tmp_path):
    scene, model, owners = small_scene(40), random_gaussians(40), torch.arange(40) % 2
    views = [torch.arange(len(scene.views)) % 2 == b for b in range(2)]
    facts = [BlockFacts(block=b, views=1, points=1, load=1) for b in range(2)]
    ends = []
    for engine in ("inline", "ray"):
        run = Run(backend="cpu", threads=1, engine=engine)
        whole = Whole(
            owners=owners, moving=None, scene=scene, views=views, blocks=facts,
            settings=RefineSettings(iterations=20), base=SETTINGS, pack=None,
        )  # fmt: skip
        made = part_jobs(model, whole, run, tmp_path / engine)
        refine_parts(made, run, nothing)
        ends.append(mean_of_parts(model, owners, made))
    assert torch.equal(ends[0].sh, ends[1].sh)
    assert not torch.equal(ends[0].sh, model.sh)


@pytest.mark.slow  # another worker with all imports
def test_a_blocks_own_error_names_it(tmp_path, cluster):
    spoilt = jobs(tmp_path, replace(SETTINGS, iterations=10))
    checkpoint = spoilt[1].folder / "checkpoint" / "training.safetensors"
    checkpoint.parent.mkdir(parents=True)
    checkpoint.write_bytes(b"spoilt")
    with pytest.raises(DataError, match="block 1: .*not a whole safetensors file"):
        run_blocks(spoilt[1:], engine="ray", threads=1, report=nothing)


def test_without_the_package_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingError, match=r"pip install splatproof\[distributed\]"):
        ray_executor.run_on_ray(jobs(tmp_path), 1, 1, nothing)


def test_blocks_on_dead_machines_are_known_and_those_that_have_not_begun_are_not():
    ray = SimpleNamespace(
        nodes=lambda: [{"NodeID": "near", "Alive": True}, {"NodeID": "far", "Alive": False}]
    )
    running = {"first": 0, "second": 1, "waiting": 2}
    assert ray_executor._stranded(ray, running, {0: "near", 1: "far"}) == ["second"]
