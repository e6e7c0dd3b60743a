"""Films: what is in them, and what is refused."""

import json
from pathlib import Path

import pytest
import torch

from splatproof.base.errors import MissingError, UsageError
from splatproof.cli import main
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.viewing.film import check_film, writing
from splatproof.viewing.frames import bytes_of
from splatproof.viewing.stage import Shown, Stage
from splatproof.viewing.turntable import cameras, still

av = pytest.importorskip("av", reason="the package av is not installed")


def frames_of(path: Path):
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        return stream, [frame.to_ndarray(format="rgb24") for frame in film.decode(stream)]


@pytest.fixture
def folder(truth, tmp_path: Path) -> Path:
    save_model(truth, tmp_path / "model", Origin())
    return tmp_path / "model"


@pytest.mark.parametrize("ending", ["mp4", "webm"])
def test_a_film_holds_the_frames_of_the_orbit(folder, truth, tmp_path, ending, capsys):
    out = tmp_path / f"film.{ending}"
    options = [
        "--seconds",
        "0.5",
        "--fps",
        "12",
        "--width",
        "96",
        "--height",
        "64",
        "--json",
        "--quiet",
    ]
    assert main(["turntable", str(folder), str(out), *options]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {
        "out": str(out),
        "frames": 6,
        "width": 96,
        "height": 64,
        "fps": 12.0,
        "path": "orbit",
    }
    stream, frames = frames_of(out)
    assert (stream.width, stream.height, len(frames)) == (96, 64, 6)
    assert float(stream.average_rate) == 12
    stage = Stage((Shown(name="m", model=truth),), None)
    for (camera, moment), frame in zip(
        cameras(stage, "orbit", 6, width=96, height=64), frames, strict=True
    ):
        exact = torch.from_numpy(bytes_of(still(stage, camera, moment, "colour"))).float()
        got = torch.from_numpy(frame).float()
        assert float((got - exact).abs().mean()) < 6  # colour at half the resolution
        assert (
            float((got.flip(1) - exact).abs().mean()) > 12
        )  # the control: a mirrored frame is not it
    assert not list(tmp_path.glob("*.partial"))


def test_colours_are_right(tmp_path: Path):
    out = tmp_path / "red.mp4"
    picture = torch.tensor([0.8, 0.2, 0.1]).expand(32, 32, 3)
    with writing(out, width=32, height=32, fps=10.0) as film:
        film.add(bytes_of(picture))
    stream, (frame,) = frames_of(out)
    assert stream.codec_context.colorspace == 1  # BT.709 is said, so players need not guess
    assert frame.mean(axis=(0, 1)) == pytest.approx([204, 51, 26], abs=12)


def test_the_path_along_the_cameras_ends_at_the_last(stage: Stage):
    walked = cameras(stage, "cameras", 5, width=64, height=36)
    assert torch.allclose(walked[-1][0].centre, stage.training[-1].camera.centre)


def test_a_film_that_is_broken_off_is_not_there(tmp_path: Path):
    out = tmp_path / "film.mp4"
    with pytest.raises(KeyboardInterrupt), writing(out, width=32, height=32, fps=10.0):
        raise KeyboardInterrupt
    assert not out.exists()


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("film.gif", [], "expected .mp4 or .webm"),
        ("film.mp4", ["--width", "97"], "expected even numbers"),
        ("film.mp4", ["--fps", "0"], "both more than 0"),
        ("film.mp4", ["--seconds", "nan"], "expected a finite number"),
        ("film.mp4", ["--path", "cameras"], "name a --scene"),
        ("film.mp4", ["--mode", "error"], "--mode error: there is no scene"),
    ],
)
def test_what_cannot_be_filmed_is_refused(folder, tmp_path, name, options, words, capsys):
    out = tmp_path / name
    assert main(["turntable", str(folder), str(out), "--quiet", *options]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_without_the_package_one_is_told_how_to_get_it(monkeypatch, tmp_path: Path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingError, match=r"splatproof\[video\]"):
        check_film(tmp_path / "film.mp4", 32, 32)
    with pytest.raises(UsageError):
        check_film(tmp_path / "film.mp4", 31, 32)
