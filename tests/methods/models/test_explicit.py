"""Model folders: exact round trip; damaged, foreign and newer ones refused in one line."""

import json
import os
from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera, random_gaussians
from splatproof.base.errors import DataError
from splatproof.methods.models.explicit import (
    FIELDS,
    ExplicitModel,
    Reconstruction,
    load_reconstruction,
)
from splatproof.reference.rasterizer import rasterize as rasterizer


@pytest.fixture
def model() -> ExplicitModel:
    return ExplicitModel(
        model=random_gaussians(12, degree=2),
        method="3dgs",
        settings={"iterations": 5},
        mode="antialiased",
        shift=torch.tensor([5e5, 4.2e6, 0.1], dtype=torch.float64),
        units="metres",
        backend="reference",
    )


def test_round_trip_is_exact(model, tmp_path):
    model.save(tmp_path)
    back = load_reconstruction(tmp_path, backend="reference")
    assert isinstance(back, ExplicitModel)
    assert isinstance(back, Reconstruction)
    for name in FIELDS:
        assert torch.equal(getattr(back.model, name), getattr(model.model, name))
    assert torch.equal(back.shift, model.shift)
    assert (back.method, back.settings, back.units, back.mode) == (
        "3dgs", {"iterations": 5}, "metres", "antialiased",
    )  # fmt: skip
    assert torch.equal(back.render(camera(1)).colour, model.render(camera(1)).colour)


def test_render_is_the_rasterizer(model):
    g, white = model.model, torch.ones(3)
    want = rasterizer.rasterize(
        camera(2), g.means, g.quaternions, g.scales, g.opacities, sh=g.sh, background=white,
        mode="antialiased",
    )  # fmt: skip
    assert torch.equal(model.render(camera(2), white).colour, want.colour)


def test_saving_twice_gives_the_same_bytes(model, tmp_path):
    model.save(tmp_path / "a")
    model.save(tmp_path / "b")
    for name in ("model.safetensors", "model.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_an_interrupted_save_is_refused_and_leaves_nothing(model, tmp_path, monkeypatch):
    model.save(tmp_path)

    def fail(*args):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        model.save(tmp_path)
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
    "kind 'anchors', expected explicit or city": lambda f: edit(f, kind="anchors"),
    "shift has shape": lambda f: edit(f, shift=[1.0]),
    "mode 'blurred'": lambda f: edit(f, mode="blurred"),
    "sha256 is not the one": flip_a_byte,
    "not a whole safetensors file": cut,
    "model.safetensors: no such file": lambda f: (f / "model.safetensors").unlink(),
}


@pytest.mark.parametrize("said", SPOILERS)
def test_spoilt_folders_are_refused_in_one_line(model, tmp_path, said):
    model.save(tmp_path)
    SPOILERS[said](tmp_path)
    with pytest.raises(DataError, match=said) as error:
        load_reconstruction(tmp_path)
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_numbers_that_are_not_finite_are_named(model, tmp_path):
    scales = model.model.log_scales.clone()
    scales[7, 1] = torch.nan
    replace(model, model=replace(model.model, log_scales=scales)).save(tmp_path)
    with pytest.raises(DataError, match="log_scales of Gaussian 7 is not finite"):
        load_reconstruction(tmp_path)
