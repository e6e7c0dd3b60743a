"""A third party's methods, metric and adapter do all that ours do, without a change anywhere else."""

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.reel_scene import photo, write_reel
from helpers.tiny_scene import camera
from splatproof.base.errors import DataError
from splatproof.base.tensor_files import read_tensors
from splatproof.datasets.photos import read_photo
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.storage.ply import read_ply

BENCH = str(Path(sys.executable).with_name("bench"))
METHODS = ("relocating", "tiny-anchors", "drifting")
STEPS = 200
SUITE = f"""
description = "A third party's methods"
[[cases]]
scenes = ["./reel"]
methods = {json.dumps(METHODS)}
protocols = ["./biased.toml"]
seeds = [0]
shared = {{ iterations = {STEPS} }}
"""
PROTOCOL = """
source = "ours"
hold = 4
metrics = ["psnr", "brightness_bias"]
"""


def bench(folder: Path, environment: dict[str, str], *arguments: str) -> list[dict[str, Any]]:
    """The lines that a command prints with --json."""
    process = subprocess.run(
        [BENCH, *arguments, "--json", "--quiet"], cwd=folder, env=environment, text=True,
        capture_output=True, timeout=900, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return [json.loads(line) for line in process.stdout.splitlines()]


def prepared(folder: Path) -> Path:
    write_reel(folder / "reel")
    (folder / "mine.toml").write_text(SUITE)
    (folder / "biased.toml").write_text(PROTOCOL)
    return folder


TOGETHER = """
import json, sys
from splatproof.cli import main
for arguments in json.loads(sys.argv[1]):
    if code := main([*arguments, "--quiet"]):
        sys.exit(code)
"""
"""Several commands in one process: each of its own would import all again, for seconds."""


def bench_together(folder: Path, environment: dict[str, str], commands: list[list[str]]) -> None:
    process = subprocess.run(
        [sys.executable, "-P", "-c", TOGETHER, json.dumps(commands)], cwd=folder, env=environment,
        text=True, capture_output=True, timeout=900, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr


@pytest.fixture(scope="module")
def straight(tmp_path_factory, environment) -> tuple[Path, list[dict[str, Any]]]:
    """The suite, run without a disturbance."""
    folder = prepared(tmp_path_factory.mktemp("straight"))
    return folder, bench(folder, environment, "run", "mine.toml")


def case(folder: Path, method: str) -> Path:
    return folder / "runs" / "mine" / "reel" / method / "biased" / "seed0"


def test_every_method_learns_and_is_scored_by_the_metric(straight):
    _, cases = straight
    assert [line["method"] for line in cases] == list(METHODS)
    for line in cases:
        assert line["status"] == "finished"
        assert line["psnr"] > 18  # grey images have 13 dB here
        assert 0 <= line["brightness_bias"] < 0.1
    by_method = {line["method"]: line["psnr"] for line in cases}
    assert by_method["drifting"] > by_method["relocating"] + 1  # half of the world moves


def test_the_record_says_how_gradients_were_computed_and_curves_name_the_terms(straight):
    folder, _ = straight
    path = {"relocating": "kernels", "tiny-anchors": "autograd", "drifting": "autograd"}
    for method in METHODS:
        record = json.loads((case(folder, method) / "record.json").read_text())
        assert record["environment"]["gradients by"] == path[method]
        last = json.loads((case(folder, method) / "curve.jsonl").read_text().splitlines()[-1])
        terms = {"photometric", "volume"} if method == "tiny-anchors" else {"photometric"}
        assert terms <= set(last["values"])


@pytest.mark.slow  # many kills; tests/suites/test_kill.py has those of our own methods
def test_killed_and_continued_is_the_same_to_the_bit(straight, environment, tmp_path):
    folder, _ = straight
    killed = prepared(tmp_path / "killed")
    kills = 0
    for method in METHODS:
        checkpoint = case(killed, method) / "checkpoint" / "training.safetensors"
        curve = case(killed, method) / "curve.jsonl"
        process = subprocess.Popen(
            [BENCH, "run", "mine.toml", "--quiet", "--checkpoint-seconds", "0"], cwd=killed,
            env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        while process.poll() is None and not (checkpoint.exists() and curve.exists()):
            time.sleep(0.01)
        time.sleep(0.2)
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            kills += 1
        process.wait()
    assert kills
    bench(killed, environment, "run", "mine.toml")
    for method in METHODS:
        model = Path("model") / "model.safetensors"
        one, other = (read_tensors(case(at, method) / model)[0] for at in (folder, killed))
        assert one.keys() == other.keys()
        assert all(np.array_equal(one[name].numpy(), other[name].numpy()) for name in one)


def test_time_reaches_the_render(straight, environment, tmp_path):
    """The moving method is near the truth at times that no photo has; at another time it is not."""
    folder, _ = straight
    where = camera(2, width=48, height=36)
    entry = {"width": 48, "height": 36, "K": where.K.tolist(),
             "world_to_camera": where.world_to_camera.tolist()}  # fmt: skip
    times = {"early.png": 0.25, "late.png": 1.25}
    (tmp_path / "cameras.json").write_text(
        json.dumps([entry | {"name": name, "time": at} for name, at in times.items()])
    )
    model = str(case(folder, "drifting"))
    bench(tmp_path, environment, "render", model, "out", "--cameras", "cameras.json")
    shown = {name: read_photo(tmp_path / "out" / name) for name in times}
    truth = {name: photo(where, at) for name, at in times.items()}

    def error(one: str, other: str) -> float:
        return float((shown[one] - truth[other]).square().mean())

    # 0.53 and 0.42 were seen; without time both renders are the same, and a ratio is 1 or more
    assert error("early.png", "early.png") < 0.7 * error("early.png", "late.png")
    assert error("late.png", "late.png") < 0.7 * error("late.png", "early.png")


def test_baked_and_exported(straight, environment, tmp_path):
    folder, _ = straight
    at = {"relocating": []}  # the others are baked for a view
    bench_together(tmp_path, environment, [
        ["export", str(case(folder, method)), "--ply", f"{method}.ply",
         *at.get(method, ["--view", "04.png"])]
        for method in METHODS
    ])  # fmt: skip
    for method in METHODS:
        gaussians, _ = read_ply(tmp_path / f"{method}.ply")
        assert len(gaussians.means) > 20
        assert gaussians.means.isfinite().all()


@pytest.mark.slow  # two more starts and a training
def test_a_fit_of_one_is_the_suites_case_and_renders_its_own_views(straight, environment, tmp_path):
    folder, _ = straight
    arguments = ["../reel", "--protocol", "../biased.toml", "--iterations", str(STEPS)]
    (folder / "alone").mkdir(exist_ok=True)
    bench_together(folder / "alone", environment, [
        ["fit", "tiny-anchors", *arguments, "--out", "mine"],
        ["render", "mine", str(tmp_path / "again")],
    ])  # fmt: skip
    one, other = (
        read_tensors(at / "model" / "model.safetensors")[0]
        for at in (folder / "alone" / "mine", case(folder, "tiny-anchors"))
    )
    assert all(np.array_equal(one[name].numpy(), other[name].numpy()) for name in one)
    for path in (folder / "alone" / "mine" / "renders").iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


def test_the_report_has_every_method_and_the_metric(straight, environment):
    folder, _ = straight
    lines = bench(folder, environment, "report")
    assert {line["method"] for line in lines if "method" in line} >= set(METHODS)
    assert any("brightness_bias" in json.dumps(line) for line in lines)


def test_without_the_package_its_model_is_refused_in_one_line(straight, tmp_path):
    folder, _ = straight
    (tmp_path / "cameras.json").write_text("[]")
    arguments = [str(tmp_path / "out"), "--cameras", "cameras.json", "--protocol", "default"]
    with pytest.raises(DataError, match=r"kind 'drifting', .*install the package"):
        load_reconstruction(case(folder, "drifting") / "model")
    process = subprocess.run(
        [BENCH, "render", str(case(folder, "drifting")), *arguments], text=True,
        capture_output=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert (process.returncode, process.stderr.count("\n")) == (2, 1)


def test_a_damaged_index_is_named(environment, tmp_path):
    prepared(tmp_path / "spoilt")
    index = tmp_path / "spoilt" / "reel" / "reel.csv"
    lines = list(csv.reader(index.read_text().splitlines()))
    lines[3] = lines[3][:7]
    with index.open("w", newline="") as file:
        csv.writer(file).writerows(lines)
    process = subprocess.run(
        [BENCH, "fit", "drifting", "reel", "--out", "x", "--quiet"], cwd=tmp_path / "spoilt",
        env=environment, text=True, capture_output=True, check=False,
    )  # fmt: skip
    assert process.returncode == 2
    assert "reel.csv: line 4" in process.stderr
