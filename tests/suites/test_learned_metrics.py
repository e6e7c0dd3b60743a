"""A protocol that asks for a learned metric works from a suite where the weights are, and only there."""

from dataclasses import replace

import pytest
import torch

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from helpers.random_weights import forget, write_weights
from splatproof.cli import main
from splatproof.methods.registry import METHODS
from splatproof.metrics import weights
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites import run_case as cases
from splatproof.suites.runner import run_suite
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_process

PROTOCOL = replace(load_protocol("default"), metrics=("psnr", "lpips_vgg_m11"))
LEARNED = 'source = "me"\nmasked = false\nmetrics = ["psnr", "lpips_alex_m11"]\n'
SUITE = """
description = "For tests"
[[cases]]
scenes = ["courtyard"]
methods = ["3dgs"]
protocols = ["./learned.toml"]
"""


@pytest.fixture(autouse=True)
def no_weights(tmp_path, monkeypatch):
    """Nothing is where weights are looked for."""
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setenv(weights.VARIABLE, str(tmp_path / "mine"))
    forget()
    yield
    forget()


@pytest.fixture
def suite(monkeypatch) -> Suite:
    monkeypatch.setitem(METHODS, "fake", None)
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    fake_methods.register()
    case = Case(scene="town", method="fake", settings=FakeSettings(), seed=0, protocol=PROTOCOL)
    return Suite(name="tiny", description="For tests", cases=(case,), scenes=("town",))


def test_the_record_has_the_score_and_the_hash_of_the_weights(suite, tmp_path, monkeypatch):
    sha = write_weights(tmp_path / "mine", "vgg", monkeypatch)
    (outcome,) = run_suite(suite, tmp_path / "runs", backend="reference", launch=in_process)
    assert not outcome.result.error
    assert outcome.result.metrics["lpips_vgg_m11"] > 0
    assert outcome.result.environment["weights of lpips_vgg_m11"] == sha


def test_without_weights_a_case_fails_before_it_trains(suite, tmp_path):
    (outcome,) = run_suite(suite, tmp_path / "runs", backend="reference", launch=in_process)
    assert f"not in {tmp_path / 'mine'}" in outcome.result.error
    assert not (outcome.folder / "curve.jsonl").exists()


@pytest.mark.parametrize("command", ["run", "fit"])
def test_without_weights_the_commands_say_so_and_leave_nothing(
    command, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "learned.toml").write_text(LEARNED)
    (tmp_path / "mine.toml").write_text(SUITE)
    arguments = {
        "run": ["run", "mine.toml"],
        "fit": ["fit", "3dgs", "courtyard", "--out", "out", "--protocol", "learned.toml"],
    }
    before = sorted(tmp_path.iterdir())
    assert main(arguments[command]) == 3
    (said,) = capsys.readouterr().err.splitlines()
    assert "weights alexnet-owt-7be5be79.pth are not in" in said
    assert "download https://" in said
    assert sorted(tmp_path.iterdir()) == before
