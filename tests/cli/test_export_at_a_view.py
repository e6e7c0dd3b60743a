"""`bench export --view` and `bench render --cameras`: models that look different from each view."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from helpers import fake_methods
from helpers.tiny_scene import camera, random_gaussians, tiny_scene
from splatproof.cli import main
from splatproof.datasets.catalogue import opening
from splatproof.methods.contracts.method import Method
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.loading import load_origin, load_reconstruction
from splatproof.methods.models.decoded import DecodedModel, loader
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.registry import METHODS
from splatproof.methods.storage.packed.coded_writer import CodeSettings
from splatproof.methods.storage.ply import read_ply
from splatproof.methods.training.schedules import Rates
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import camera_view

KIND = "moving"
TIMES = {f"{index}.png": 0.5 * index for index in range(6)}
SHIFT = torch.tensor([10.0, 20.0, 0.0], dtype=torch.float64)


class Moving(GaussianModel):
    """Gaussians that the time moves along x, the camera along y; the light depends on appearance."""

    def splats(self, view, moment):
        found = super().splats(view, moment)
        move = torch.tensor([view.time or 0.0, float(view.camera.centre[0]), 0.0])
        return replace(found, means=found.means + 0.1 * move)

    def finish_image(self, view, output):
        return output.colour * (0.5 if (view.appearance, view.sensor) == ("3.png", "left") else 1)


def build(facts, tensors) -> Moving:
    del facts, tensors
    return Moving(random_gaussians(12, degree=0), Rates(), extent=1.0, mode="antialiased")


MODEL = DecodedModel(kind=KIND, model=build({}, {}), shift=SHIFT, backend="reference")
ORIGIN = Origin(
    method=KIND, scene="somewhere", seed=2, protocol=json.loads(json.dumps(asdict(load_protocol("3dgs"))))
)  # fmt: skip


@pytest.fixture
def asked(monkeypatch) -> list:
    """What is opened: (scene, protocol); it is the tiny scene with times each time."""
    seen = []

    def opened(spec, protocol):
        seen.append((spec, protocol))
        scene = tiny_scene()
        return replace(scene, views=tuple(replace(v, time=TIMES[v.name]) for v in scene.views))

    monkeypatch.setattr(opening, "open_scene", opened)
    return seen


@pytest.fixture
def moving(tmp_path, monkeypatch, asked) -> str:
    """Folder of a model that looks different from each view."""
    del asked
    method = Method(
        name=KIND, settings=fake_methods.FakeSettings, fit=fake_methods.fit,
        cost=fake_methods.cost, description="", loaders={KIND: loader(KIND, build)},
    )  # fmt: skip
    monkeypatch.setitem(METHODS, KIND, method)
    save_model(MODEL, tmp_path / "model", ORIGIN)
    return str(tmp_path / "model")


@pytest.fixture
def cameras(tmp_path) -> str:
    """A file of one camera, of another time and light."""
    where = camera(4)
    entry = {
        "name": "mine", "width": where.width, "height": where.height, "K": where.K.tolist(),
        "world_to_camera": where.world_to_camera.tolist(), "time": 7.0, "sensor": "left",
        "appearance": "3.png",
    }  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps([entry]))
    return str(tmp_path / "cameras.json")


def means(path: Path) -> torch.Tensor:
    return read_ply(path)[0].means


def at(index: int, time: float | None):
    return MODEL.bake(camera_view(camera(index), time=time))


def test_a_view_of_the_models_own_scene_at_another_time(moving, tmp_path, capsys, asked):
    ply, packed = tmp_path / "m.ply", tmp_path / "m.spgs"
    options = ["--ply", str(ply), "--packed", str(packed), "--view", "2.png", "--time", "1.75"]
    assert main(["export", moving, *options, "--local", "--json"]) == 0
    assert asked == [("somewhere", load_protocol("3dgs"))]
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [set(line) & {"ply", "packed"} for line in lines] == [{"packed"}, {"ply"}]
    for line in lines:
        assert (line["view"], line["time"], line["gaussians"]) == ("2.png", 1.75, 12)
    want = at(2, 1.75)
    assert torch.equal(means(ply), want.means)
    assert not torch.equal(want.means, at(2, 1.0).means)
    assert not torch.equal(want.means, at(3, 1.75).means)
    back = load_reconstruction(packed)
    assert isinstance(back, ExplicitModel)
    off = back.model.means.sort(dim=0)[0] - want.means.sort(dim=0)[0]
    middle = want.log_scales.median(dim=1).values.exp()
    assert off.abs().max() <= CodeSettings().position / 2 * middle.quantile(0.5) * 1.001
    assert (back.mode, back.shift.tolist()) == ("antialiased", SHIFT.tolist())
    assert load_origin(packed) == ORIGIN


def test_without_a_time_that_of_the_view_counts(moving, tmp_path, capsys):
    ply = tmp_path / "m.ply"
    assert main(["export", moving, "--ply", str(ply), "--local", "--view", "3.png"]) == 0
    assert (
        "12 Gaussians as seen from 3.png at 1.5 s, positions as trained" in capsys.readouterr().out
    )
    assert torch.equal(means(ply), at(3, TIMES["3.png"]).means)


@pytest.mark.parametrize("lacks", [("its sky", "its shade"), ()])
def test_what_no_gaussian_shows_is_named_in_one_line(moving, tmp_path, capsys, monkeypatch, lacks):
    arguments = ["export", moving, "--ply", str(tmp_path / "m.ply"), "--view", "3.png"]
    assert main(arguments) == 0
    assert "what is written lacks what it adds to a rasterized image" in capsys.readouterr().err
    monkeypatch.setattr(Moving, "unbaked", lacks)
    assert main(arguments) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "what is written" in line]
    assert told == [f"{moving}: what is written lacks {' and '.join(lacks)}"] * bool(lacks)


def test_another_scene_and_protocol_go_first(moving, tmp_path, asked):
    options = ["--view", "1.png", "--scene", "elsewhere", "--protocol", "quick"]
    assert main(["export", moving, "--ply", str(tmp_path / "m.ply"), *options]) == 0
    assert asked == [("elsewhere", load_protocol("quick"))]


def test_a_camera_of_a_file(moving, cameras, tmp_path, asked, capsys):
    ply, options = tmp_path / "m.ply", ["--local", "--cameras", cameras, "--json"]
    assert main(["export", moving, "--ply", str(ply), *options, "--view", "mine"]) == 0
    assert json.loads(capsys.readouterr().out)["time"] == 7.0
    assert torch.equal(means(ply), at(4, 7.0).means)
    assert (
        main(["export", moving, "--ply", str(ply), *options, "--view", "mine", "--time", "2"]) == 0
    )
    assert torch.equal(means(ply), at(4, 2.0).means)
    assert not asked


@pytest.mark.parametrize("kind", ["--ply", "--packed"])
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "looks different from every view; name the one to bake it at: --view NAME"),
        (["--view", "2.pgn"], "--view: unknown '2.pgn', did you mean '2.png'?"),
        (["--time", "1"], "--time belongs to a view; name it with --view NAME"),
        (["--scene", "x"], "--scene belongs to a view"),
        (["--view", "2.png", "--time", "nan"], "--time is nan, expected a finite number"),
        (
            ["--view", "x", "--cameras", "c.json", "--scene", "y"],
            "leave --scene and --protocol out",
        ),
        (["--view", "x", "--cameras", "none.json"], "none.json: no such file"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(moving, tmp_path, capsys, kind, options, said):
    before, ending = sorted(tmp_path.rglob("*")), {"--ply": ".ply"}.get(kind, "")
    assert main(["export", moving, kind, str(tmp_path / f"m{ending}"), *options]) == 2
    text = capsys.readouterr().err
    assert said in " ".join(text.replace("│", "").split())
    assert sorted(tmp_path.rglob("*")) == before


def test_plain_gaussians_need_no_view_and_refuse_one(tmp_path, capsys):
    save_model(ExplicitModel(model=random_gaussians(5)), tmp_path / "model", ORIGIN)
    arguments = ["export", str(tmp_path / "model"), "--ply", str(tmp_path / "m.ply")]
    assert main([*arguments, "--view", "0.png"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "look the same from every view at any time; leave --view out" in line
    assert not (tmp_path / "m.ply").exists()
    assert main([*arguments, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["view"], told["time"]) == (None, None)


def test_a_camera_file_says_when_and_in_whose_light_a_model_is_rendered(moving, cameras, tmp_path):
    out = tmp_path / "out"
    options = ["--cameras", cameras, "--backend", "reference"]
    assert main(["render", moving, str(out), *options]) == 0
    got = cv2.imread(str(out / "mine.png"))
    assert got is not None
    view = camera_view(camera(4), time=7.0)

    def shown(seen) -> np.ndarray:
        image = MODEL.render(seen, torch.tensor(load_protocol("3dgs").background)).colour
        return np.floor(image.clamp(0, 1).numpy() * 255 + 0.5)[..., ::-1]

    assert np.array_equal(got, shown(replace(view, sensor="left", appearance="3.png")))
    assert not np.array_equal(got, shown(view))
    assert not np.array_equal(
        got, shown(replace(view, sensor="left", appearance="3.png", time=None))
    )
