"""What `bench view --measure` measures, and that it is fast enough."""

import json
from pathlib import Path

import pytest
import torch

from splatproof.cli import main
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.viewing import measuring
from splatproof.viewing.asked import read_asked
from splatproof.viewing.measuring import query, random_stage, sway
from splatproof.viewing.stage import Stage


def test_a_query_asks_for_the_camera_that_it_is_made_of():
    _, camera = random_stage("cpu")
    asked = read_asked(random_stage("cpu")[0], query(camera, 0)).camera
    assert torch.allclose(asked.world_to_camera, camera.world_to_camera, atol=1e-6)
    assert torch.allclose(asked.K, camera.K, rtol=1e-6)
    assert len(sway(camera, 4)) == 4 + measuring.WARM_UP


def test_frames_of_a_model_are_timed(truth, tmp_path: Path, capsys):
    save_model(truth, tmp_path / "model", Origin())
    assert main(["view", str(tmp_path / "model"), "--measure", "4", "--json", "--quiet"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["frames"], told["primitives"], told["width"], told["height"]) == (4, 40, 640, 360)
    assert 0 < told["render_ms"] < told["round_trip_ms"]
    assert told["jpeg_psnr"] > 30
    assert 0 < told["frames_per_second"] <= 1100 / told["round_trip_ms"] * 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "name at least one model"),
        (["--measure", "0"], "expected 1 or more frames"),
        (["nowhere"], "no such file"),
    ],
)
def test_what_cannot_be_shown_is_refused(options, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["view", *options, "--quiet"]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.slow
def test_two_cores_have_time_for_15_frames_a_second():
    """100,000 Gaussians, 640 x 360: 81 to 124 ms of processor time a frame were measured beside other work."""
    stage, camera = random_stage("cpu")
    assert isinstance(stage, Stage)
    found = measuring.measured(stage, sway(camera, 30))
    assert found.cpu_ms < 2 * 1000 / 15
