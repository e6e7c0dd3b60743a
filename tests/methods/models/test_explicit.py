"""Model folders: exact round trip; damaged, foreign and newer ones refused in one line."""

import json
import os
from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera, random_gaussians
from splatproof.base.errors import DataError
from splatproof.methods.contracts.reconstruction import Origin, Reconstruction, save_model
from splatproof.methods.loading import load_origin, load_reconstruction
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.reference.rasterizer import rasterize as rasterizer
from splatproof.reference.types.scene import camera_view

ORIGIN = Origin(
    method="3dgs", variant="short", settings={"iterations": 5}, scene="tiny",
    protocol={"name": "default"}, seed=3, pose_noise="L1",
)  # fmt: skip


@pytest.fixture
def model() -> ExplicitModel:
    return ExplicitModel(
        model=random_gaussians(12, degree=2),
        mode="antialiased",
        shift=torch.tensor([5e5, 4.2e6, 0.1], dtype=torch.float64),
        units="metres",
        backend="reference",
    )


def test_round_trip_is_exact(model, tmp_path):
    save_model(model, tmp_path, ORIGIN)
    back = load_reconstruction(tmp_path, backend="reference")
    assert isinstance(back, ExplicitModel)
    assert isinstance(back, Reconstruction)
    for name in FIELDS:
        assert torch.equal(getattr(back.model, name), getattr(model.model, name))
    assert torch.equal(back.shift, model.shift)
    assert (back.units, back.mode) == ("metres", "antialiased")
    assert load_origin(tmp_path) == ORIGIN
    view = camera_view(camera(1))
    assert torch.equal(back.render(view).colour, model.render(view).colour)


def test_render_is_the_rasterizer(model):
    g, white = model.model, torch.ones(3)
    want = rasterizer.rasterize(
        camera(2), g.means, g.quaternions, g.scales, g.opacities, sh=g.sh, background=white,
        mode="antialiased",
    )  # fmt: skip
    assert torch.equal(model.render(camera_view(camera(2)), white).colour, want.colour)


def test_saving_twice_gives_the_same_bytes(model, tmp_path):
    save_model(model, tmp_path / "a", ORIGIN)
    save_model(model, tmp_path / "b", ORIGIN)
    for name in ("model.safetensors", "model.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_an_interrupted_save_is_refused_and_leaves_nothing(model, tmp_path, monkeypatch):
    save_model(model, tmp_path, ORIGIN)

    def fail(*args):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        save_model(model, tmp_path, ORIGIN)
    assert not list(tmp_path.glob("*.partial"))
    with pytest.raises(DataError, match="model.json: no such file"):
        load_reconstruction(tmp_path)


def edit(folder, **changes):
    facts = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps(facts | changes))


def flip_a_byte(folder):
    path = folder / "model.safetensors"
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)


def cut(folder):
    path = folder / "model.safetensors"
    path.write_bytes(path.read_bytes()[:-1])


SPOILERS = {
    "model.json: not JSON": lambda f: (f / "model.json").write_text("{"),
    "model.json: not a model of splatproof": lambda f: (f / "model.json").write_text("[1]"),
    "version 2, this splatproof reads 1": lambda f: edit(f, version=2),
    "kind 'anchors', this installation loads city, .*explicit": lambda f: edit(f, kind="anchors"),
    "origin is None": lambda f: edit(f, origin=None),
    "shift is .1.0., expected 3 finite numbers": lambda f: edit(f, shift=[1.0]),
    "mode 'blurred'": lambda f: edit(f, mode="blurred"),
    "sha256 is not the one": flip_a_byte,
    "not a whole safetensors file": cut,
    "model.safetensors: no such file": lambda f: (f / "model.safetensors").unlink(),
}


@pytest.mark.parametrize("said", SPOILERS)
def test_spoilt_folders_are_refused_in_one_line(model, tmp_path, said):
    save_model(model, tmp_path, ORIGIN)
    SPOILERS[said](tmp_path)
    load = load_origin if said.startswith("origin") else load_reconstruction
    with pytest.raises(DataError, match=said) as error:
        load(tmp_path)
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_numbers_that_are_not_finite_are_named(model, tmp_path):
    scales = model.model.log_scales.clone()
    scales[7, 1] = torch.nan
    spoilt = replace(model, model=replace(model.model, log_scales=scales))
    save_model(spoilt, tmp_path, ORIGIN)
    with pytest.raises(DataError, match="log_scales of Gaussian 7 is not finite"):
        load_reconstruction(tmp_path)
