"""`bench train-prior`: what it makes, that it learns, and what it refuses."""

import json
import os

import pytest
import torch

from helpers.prior_scenes import plane_scene
from helpers.textured_scene import textured_scene
from helpers.tiny_scene import tiny_scene
from splatproof.base.files import sha256
from splatproof.cli import main, train_prior
from splatproof.methods.dpgs import refiner_training
from splatproof.methods.priors import network, own_matcher_training
from splatproof.methods.priors.network import load_network
from splatproof.methods.priors.own_matcher import load_own_matcher
from splatproof.methods.priors.unet import load_facts
from splatproof.methods.priors.view_refiner import load_refiner


@pytest.fixture
def _tiny(monkeypatch, tmp_path) -> None:
    """Worlds are the plane, and the network sees little of it."""
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(network, "LONGER", 32)
    monkeypatch.setattr(train_prior, "CURVE_EVERY", 4)
    monkeypatch.setattr(train_prior, "_scenes", lambda world, preset, seed: [plane_scene()])


@pytest.mark.usefixtures("_tiny")
def test_it_trains_and_says_how(tmp_path, capsys):
    out = tmp_path / "net.safetensors"
    told = ["train-prior", "depth", str(out), "--worlds", "street", "--seeds", "2", "--steps", "12"]
    assert main(told) == 0
    record = json.loads(out.with_suffix(".json").read_text())
    assert record["command"] == (
        "bench train-prior depth net.safetensors --worlds street --preset small --seeds 2 --steps 12"
    )
    assert record["sha256"] == sha256(out)
    assert (record["seeds"], record["views"], len(record["loss"])) == ([1000, 1001], 8, 3)
    assert record["loss"][-1] < record["loss"][0]
    assert load_facts(out)["worlds"] == ["street"]
    before = load_network(out).state_dict()
    assert main(told) == 0
    after = load_network(out).state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    capsys.readouterr()


def test_the_refiner_trains_and_says_what_it_does_for_worlds_apart(monkeypatch, tmp_path, capsys):
    asked = []

    def scenes(world, preset, seed, protocol):
        asked.append((world, seed, protocol))
        return [tiny_scene()]

    monkeypatch.setattr(refiner_training, "CROP", 16)
    monkeypatch.setattr(train_prior, "_scenes", scenes)
    monkeypatch.setattr(train_prior, "CURVE_EVERY", 4)
    out = tmp_path / "r.safetensors"
    told = ["--worlds", "city", "--seeds", "2", "--steps", "8", "--model-steps", "3"]
    assert main(["train-prior", "refiner", str(out), *told]) == 0
    record = json.loads(out.with_suffix(".json").read_text())
    assert record["command"] == (
        "bench train-prior refiner r.safetensors --worlds city --preset small --seeds 2 --steps 8 "
        "--model-steps 3"
    )
    assert asked == [("city", seed, "city_unseen") for seed in (1000, 1001, 1002)]
    assert (record["views"], len(record["loss"])) == (4, 2)
    assert set(record["error_apart"]) == {"render", "warp", "own"}
    assert record["sha256"] == sha256(out)
    load_refiner(out)
    capsys.readouterr()


def test_the_matcher_trains_and_says_what_it_does_for_worlds_apart(monkeypatch, tmp_path, capsys):
    asked = []

    def scenes(world, preset, seed):
        asked.append((world, seed))
        return [textured_scene()]

    monkeypatch.setattr(own_matcher_training, "CROP", (32, 32))
    monkeypatch.setattr(own_matcher_training, "COMPARED", 1)
    monkeypatch.setattr(train_prior, "_scenes", scenes)
    monkeypatch.setattr(train_prior, "CURVE_EVERY", 4)
    out = tmp_path / "m.safetensors"
    told = ["train-prior", "matcher", str(out), "--worlds", "city", "--seeds", "1", "--steps", "4"]
    assert main(told) == 0
    record = json.loads(out.with_suffix(".json").read_text())
    assert record["command"] == (
        "bench train-prior matcher m.safetensors --worlds city --preset small --seeds 1 --steps 4"
    )
    assert asked == [("city", 1000), ("city", 1001)]
    assert (record["pairs"], len(record["loss"])) == (6, 1)
    assert set(record["apart"]["city"]) == {"flow", "own"}
    assert set(record["apart"]["city"]["own"]) == {"sure", "median", "off"}
    assert record["sha256"] == sha256(out)
    load_own_matcher(out)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--worlds", "tunnel"], "tunnel: no views apart from its photos; there are city, aerial-"),
        (["--model-steps", "0"], "--model-steps is 0, expected 1 or more"),
        (["--worlds", "moon"], "moon: no such world"),
    ],
)
def test_what_no_refiner_learns_of_is_said_in_one_line(given, said, capsys):
    assert main(["train-prior", "refiner", "r.safetensors", *given]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["net.bin"], "net.bin: expected a file name that ends in .safetensors"),
        (["n.safetensors", "--steps", "0"], "--steps is 0, expected 1 or more"),
        (["n.safetensors", "--seeds", "0"], "--seeds is 0, expected 1 or more"),
        (["n.safetensors", "--worlds", "moon"], "moon: no such world; there are courtyard"),
        (["n.safetensors", "--preset", "huge"], "huge: courtyard has no such preset"),
    ],
)
def test_what_cannot_be_trained_is_said_in_one_line(given, said, capsys):
    assert main(["train-prior", "depth", *given]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.usefixtures("_tiny")
def test_a_place_that_cannot_be_written_is_refused_before_training(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(train_prior, "_trained", lambda *_: pytest.fail("trained"))
    (tmp_path / "n.safetensors").mkdir()
    assert main(["train-prior", "depth", str(tmp_path / "n.safetensors")]) == 2
    assert "is a folder, expected a file to write" in capsys.readouterr().err
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert main(["train-prior", "depth", str(tmp_path / "new/n.safetensors")]) == 3
    assert f"{tmp_path / 'new'}: cannot write here; choose" in capsys.readouterr().err


def test_worlds_are_made_once_in_the_cache_and_opened_scene_by_scene(monkeypatch, tmp_path):
    made, opened = [], []

    def make(world, preset, seed, folder, report):
        made.append((world, seed))
        for part in ("a", "b"):
            (folder / part / "sparse").mkdir(parents=True)

    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path))
    monkeypatch.setattr("splatproof.datasets.procedural.worlds.make", make)
    monkeypatch.setattr(
        "splatproof.datasets.catalogue.opening.open_scene",
        lambda folder, protocol: opened.append(folder[-2:]),
    )
    for _ in range(2):
        list(train_prior._scenes("aerial-sparse", "small", 1000))
    assert made == [("aerial-sparse", 1000)]
    assert opened == ["/a", "/b"] * 2


@pytest.mark.usefixtures("_tiny")
def test_the_completion_network_trains_and_says_what_it_does_for_worlds_apart(tmp_path, capsys):
    out = tmp_path / "c.safetensors"
    told = ["train-prior", "completion", str(out), "--seeds", "1", "--steps", "12"]
    assert main(told) == 0
    record = json.loads(out.with_suffix(".json").read_text())
    assert record["command"] == (
        "bench train-prior completion c.safetensors --worlds aerial-sparse --preset small --seeds 1 --steps 12"
    )
    assert record["loss"][-1] < record["loss"][0]
    assert set(record["apart"]["aerial-sparse"]) == {"own", "nearest"}
    load_network(out)
    capsys.readouterr()
