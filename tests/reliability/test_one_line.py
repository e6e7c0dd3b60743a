"""Paths that cannot be, names of any encoding, consoles of any encoding: one line and an exit code."""

import io
import json
import os
import sys

import pytest

from helpers.case_folders import result, write_case
from helpers.colmap_scenes import Flight, write_scene
from helpers.tiny_scene import camera, random_gaussians
from splatproof.base.files import read_json, write_text
from splatproof.cli import doctor, main, output
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.models.explicit import ExplicitModel


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A model, cameras to look at it, a scene, results, and paths on which nothing can be written."""
    folder = tmp_path_factory.mktemp("house")
    save_model(
        ExplicitModel(model=random_gaussians(9), backend="reference"), folder / "model", Origin()
    )
    where = camera(0)
    entry = {"name": "0.png", "width": where.width, "height": where.height,
             "K": where.K.tolist(), "world_to_camera": where.world_to_camera.tolist()}  # fmt: skip
    (folder / "cameras.json").write_text(json.dumps([entry]))
    write_scene(folder / "scene", Flight(views=3, points=30))
    write_case(folder / "runs", result())
    (folder / "file").write_text("x")
    (folder / "folder.ply").mkdir()
    os.mkfifo(folder / "pipe")
    return folder


RENDER = ["--cameras", "cameras.json", "--backend", "reference"]
LONG = "n" * 300
LINES = [
    ["render", "model", "file", *RENDER],
    ["render", "model", "file/inner", *RENDER],
    ["render", "model", LONG, *RENDER],
    ["render", LONG, "out", *RENDER],
    ["render", "file", "out", *RENDER],
    ["render", "pipe", "out", *RENDER],
    ["render", "model", "out", "--cameras", "folder.ply", "--backend", "reference"],
    ["render", "model", "out", "--cameras", "pipe", "--backend", "reference"],
    ["render", "model", "out", "--cameras", LONG, "--backend", "reference"],
    ["export", "model", "--ply", "folder.ply"],
    ["export", "model", "--ply", "file/a.ply"],
    ["export", "model", "--ply", f"{LONG}.ply"],
    ["export", "model", "--packed", "pipe"],
    ["export", "model", "--packed", "/dev/full"],
    ["export", "file", "--ply", "a.ply"],
    ["run", "file", "--out", "out"],
    ["run", "folder.ply", "--out", "out"],
    ["run", f"{LONG}.toml", "--out", "out"],
    ["run", "pipe", "--out", "out"],
    ["fit", "3dgs", "scene", "--out", "file"],
    ["fit", "3dgs", "scene", "--out", "file/inner"],
    ["fit", "3dgs", "scene", "--out", LONG],
    ["fit", "3dgs", "file", "--out", "out"],
    ["fit", "3dgs", LONG, "--out", "out"],
    ["fit", "3dgs", "scene", "--out", "out", "--protocol", "pipe"],
    ["fit", "3dgs", "scene", "--out", "out", "--protocol", f"{LONG}.toml"],
    ["score", "file", "scene/photos"],
    ["score", "scene/photos", LONG],
    ["score", "scene/photos", "pipe"],
    ["ingest", "file", "out"],
    ["ingest", LONG, "out"],
    ["ingest", "scene/photos", "file"],
    ["ingest", "scene/photos", "file/inner"],
    ["ingest", "scene/photos", LONG],
    ["ingest", "scene/photos", "out", "--threads", "-1"],
    ["scenes", "make", "courtyard", "file"],
    ["scenes", "make", "courtyard", "file/inner"],
    ["scenes", "make", "courtyard", LONG],
    ["gallery", "file"],
    ["report", "--out", "file"],
    ["report", "--out", LONG],
    ["report", "--uri", "sqlite:///folder.ply"],
    ["report", "--uri", "sqlite:///pipe"],
    ["report", "--uri", "http://[::1"],
    ["compare", LONG, "runs"],
    ["compare", "pipe", "runs"],
]


SLOW = ("compare", "gallery", "ingest", "report", "run", "scenes")
"""Commands that load much, or make a scene, before they look at a path."""


@pytest.mark.parametrize(
    "arguments",
    [pytest.param(a, marks=[pytest.mark.slow] if a[0] in SLOW else []) for a in LINES],
    ids=lambda one: " ".join(one)[:70],
)
def test_what_cannot_be_is_one_line(arguments, house, capsys, monkeypatch):
    monkeypatch.chdir(house)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    before = {str(path) for path in house.rglob("*")}
    assert main([*arguments, "--quiet"]) in (2, 3)
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert line.startswith("bench: ")
    assert said.out == ""
    assert {str(path) for path in house.rglob("*")} == before


LATIN = os.fsdecode(b"caf\xe9")


def test_a_name_that_is_not_utf_8(house, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(house)
    target = tmp_path / LATIN
    assert main(["export", "model", "--ply", str(target / "a.ply"), "--json"]) == 0
    assert main(["render", "model", str(target / "out"), *RENDER, "--json"]) == 0
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [told[0]["ply"], told[1]["out"]] == [str(target / "a.ply"), str(target / "out")]
    assert (target / "out" / "0.png").is_file()
    assert main(["render", str(target / "none"), "out", *RENDER]) == 2
    assert "caf\\udce9" in capsys.readouterr().err
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    assert main(["report", "--out", str(target)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "not UTF-8" in line


def test_such_a_name_comes_back_from_json(tmp_path):
    write_text(tmp_path / "a.json", json.dumps({"path": LATIN, "é": "é"}, ensure_ascii=False))
    assert read_json(tmp_path / "a.json") == {"path": LATIN, "é": "é"}


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8", "utf-16"])
def test_a_console_of_any_encoding(encoding, monkeypatch):
    record = {"path": f"é – 写真 {LATIN}"}

    def command() -> int:
        output.print_text(record["path"])
        output.print_record(record)
        output.warn(record["path"])
        return 0

    streams = {
        name: io.TextIOWrapper(io.BytesIO(), encoding=encoding) for name in ("stdout", "stderr")
    }
    monkeypatch.setattr(doctor, "doctor", command)
    with monkeypatch.context() as patch:
        for name, stream in streams.items():
            patch.setattr(sys, name, stream)
        assert main(["doctor"]) == 0
    written = streams["stdout"].buffer.getvalue().decode(encoding)
    assert json.loads(written.splitlines()[-1]) == record
