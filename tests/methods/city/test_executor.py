"""Blocks in processes of their own: the same models, and what a killed or broken worker costs."""

import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from helpers.baking import baked
from helpers.city_scene import small_scene
from splatproof.base.errors import DataError, MissingError, SplatproofError, UsageError
from splatproof.methods.city.executor import run_blocks
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.city.train_block import BlockJob
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density

SETTINGS = Settings(iterations=20, sh_degree=0, density=Density(stop=0))


def jobs(folder: Path) -> tuple[BlockJob, ...]:
    scene = small_scene(60)
    run = Run(backend="cpu", threads=1, checkpoint_seconds=0.0)
    found = partition(scene, 2, PartitionSettings(margin=0.1))
    return block_jobs(scene, found, SETTINGS, run, folder)


def means(job: BlockJob):
    return baked(load_reconstruction(job.model)).means


def nothing(*_: object) -> None: ...


@pytest.mark.parametrize("workers", [1, 2])
def test_processes_train_the_same_blocks_as_this_one(tmp_path, workers):
    here, there = jobs(tmp_path / "here"), jobs(tmp_path / "there")
    run_blocks(here, engine="inline", threads=1, report=nothing)
    heard: list[tuple[int, int]] = []
    facts = run_blocks(
        there, workers=workers, threads=2,
        report=lambda index, step, total, values: heard.append((index, step)),
    )  # fmt: skip
    assert [one.block for one in facts] == [0, 1]
    assert {(0, 20), (1, 20)} <= set(heard)
    for one, other in zip(here, there, strict=True):
        assert torch.equal(means(one), means(other))
    assert all(one.peak_mb > 0 for one in facts)


def test_a_killed_worker_is_named_and_its_block_goes_on_from_its_checkpoint(tmp_path):
    straight, killed = jobs(tmp_path / "straight"), jobs(tmp_path / "killed")
    run_blocks(straight, engine="inline", threads=1, report=nothing)

    def kill(index: int, step: int, total: int, values: dict[str, float]) -> None:
        if index == 1 and (killed[1].folder / "checkpoint").exists():
            (worker,) = multiprocessing.active_children()
            assert worker.pid is not None
            os.kill(worker.pid, signal.SIGKILL)

    with pytest.raises(SplatproofError, match=r"block 1.*SIGKILL.*continues"):
        run_blocks(killed, threads=1, report=kill)
    steps: list[tuple[int, int]] = []
    run_blocks(killed, threads=1, report=lambda i, step, *_: steps.append((i, step)))
    assert {index for index, _ in steps} == {1}
    for one, other in zip(straight, killed, strict=True):
        assert torch.equal(means(one), means(other))


def test_an_error_in_a_worker_names_the_block(tmp_path):
    spoilt = jobs(tmp_path)
    checkpoint = spoilt[1].folder / "checkpoint" / "training.safetensors"
    checkpoint.parent.mkdir(parents=True)
    checkpoint.write_bytes(b"spoilt")
    with pytest.raises(DataError, match="block 1: .*not a whole safetensors file"):
        run_blocks(spoilt[1:], threads=1, report=nothing)


def test_what_the_disk_has_against_a_worker_is_one_line_that_names_the_block(tmp_path, capfd):
    job = jobs(tmp_path)[1]
    job.folder.mkdir(parents=True)
    (job.folder / "checkpoint").symlink_to(tmp_path / "no such disk" / "folder")
    with pytest.raises(
        MissingError, match="block 1: .*checkpoint: File exists; when that is mended"
    ):
        run_blocks([job], threads=1, report=nothing)
    assert "Traceback" not in capfd.readouterr().err


def test_views_that_cannot_be_sent_are_refused(tmp_path):
    job = jobs(tmp_path)[0]
    photo = job.scene.views[0].load()
    views = tuple(replace(view, load=lambda: photo) for view in job.scene.views)
    job = replace(job, scene=replace(job.scene, views=views))
    with pytest.raises(UsageError, match="engine 'inline'"):
        run_blocks([job], threads=1, report=nothing)


def test_no_workers_are_refused(tmp_path):
    with pytest.raises(UsageError, match="0 workers"):
        run_blocks(jobs(tmp_path), workers=0, report=nothing)
