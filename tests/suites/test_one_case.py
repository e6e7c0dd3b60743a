"""A fit that somebody asks for by itself may take of the memory that is free; a suite's may not."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import METHODS, get_method
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites import one_case
from splatproof.suites import run_case as cases
from splatproof.suites.runner import run_alone, run_suite
from splatproof.suites.suite_files import Suite
from splatproof.suites.workers import in_process


def alone(method, settings, folder, seed=0):
    return one_case.job_of_one(
        method, "town", settings, out=folder, protocol=load_protocol("default"), seed=seed,
        pose_noise="none", depth_prior="none", backend="reference",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("method", "bytes_of"), [("3dgs", 3 * 2**30), ("auto", 3 * 2**30), ("odbp+stitch", 2**30)]
)
def test_photos_may_take_a_share_of_the_memory_that_is_free(
    monkeypatch, tmp_path, method, bytes_of
):
    monkeypatch.setattr(one_case, "available_mb", lambda: 10.0 * 2**10)
    _, job = alone(method, get_method(method).settings(), tmp_path)
    assert job.image_bytes == bytes_of


def test_only_what_runs_alone_goes_by_the_memory_that_is_free(monkeypatch, tmp_path):
    monkeypatch.setattr(one_case, "available_mb", lambda: 1e4)
    monkeypatch.setitem(METHODS, "fake", None)  # removed again after the test
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    fake_methods.register()
    fake, seen = METHODS["fake"], []
    monkeypatch.setitem(METHODS, "fake", replace(
        fake, fit=lambda scene, settings, run: seen.append(run.image_bytes) or fake.fit(scene, settings, run)
    ))  # fmt: skip
    suite, job = alone("fake", FakeSettings(), tmp_path / "alone")
    run_alone(job, launch=in_process)
    run_suite(Suite(name="tiny", description="", cases=suite.cases, scenes=()), tmp_path,
              backend="reference", launch=in_process)  # fmt: skip
    assert seen == [job.image_bytes, Run.image_bytes]
    assert job.image_bytes > Run.image_bytes


def test_a_negative_seed_is_refused(tmp_path):
    with pytest.raises(UsageError, match="seed -1"):
        alone("3dgs", get_method("3dgs").settings(), tmp_path, seed=-1)


@dataclass(frozen=True)
class Named:
    prior: Path = Path("depths")


def test_settings_that_no_record_can_hold_are_refused(tmp_path):
    with pytest.raises(UsageError, match=r"method 3dgs: settings.prior: PosixPath 'depths' is not"):
        alone("3dgs", Named(), tmp_path)


def test_a_kill_while_a_folder_is_emptied_leaves_one_that_can_start_over(monkeypatch, tmp_path):
    monkeypatch.setitem(METHODS, "fake", None)  # removed again after the test
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    fake_methods.register()
    _, job = alone("fake", FakeSettings(), tmp_path)
    over = replace(job, resume=False)
    first = run_alone(job, launch=in_process).result
    removed, rmtree = list[str](), shutil.rmtree

    def killed(path, *args: object, **kwargs: object) -> None:
        if removed:
            raise KeyboardInterrupt
        removed.append(path.name)
        rmtree(path)

    with monkeypatch.context() as broken:
        broken.setattr(cases.shutil, "rmtree", killed)
        with pytest.raises(KeyboardInterrupt):
            run_alone(over, launch=in_process)
    assert removed
    with pytest.raises(UsageError, match="start over in this one with --no-resume"):
        run_alone(job, launch=in_process)  # what is left of it is nobody's
    assert run_alone(over, launch=in_process).result.model_sha256 == first.model_sha256
