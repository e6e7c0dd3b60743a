"""Our own depth network: what it sees, that it learns, and its weights file."""

import json
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from helpers.prior_scenes import plane_scene
from splatproof.base.errors import DataError
from splatproof.base.files import sha256
from splatproof.base.tensor_files import write_tensors
from splatproof.cli.train_prior import MOST_BYTES
from splatproof.datasets.catalogue.registry import list_scenes
from splatproof.methods.priors import network, network_training, unet
from splatproof.methods.priors.attach import with_priors
from splatproof.methods.priors.kinds import WEIGHTS
from splatproof.methods.priors.network import (
    DepthNetwork,
    load_network,
    network_input,
    save_network,
)
from splatproof.methods.priors.network_training import affine_loss, samples_of, train
from splatproof.methods.priors.unet import load_facts
from splatproof.reference.types.scene import View


def test_it_has_as_many_parameters_as_it_says():
    count = sum(values.numel() for values in DepthNetwork().parameters())
    assert 0.75e6 < count < 0.85e6


def test_it_sees_the_photo_and_the_nearest_of_the_points_of_a_pixel():
    view: View = plane_scene().views[1]
    eye, right, ahead = view.camera.centre, view.camera.rotation[0], view.camera.rotation[2]
    aside, behind = eye + 5 * ahead + 0.5 * right, eye - ahead + 0.1 * right
    points = torch.stack([eye + 2 * ahead, eye + 4 * ahead, aside, behind])
    seen = network_input(view, points)
    assert seen.shape == (5, 96, 128)
    assert seen[4].nonzero().tolist() == [[48, 64], [48, 84]]  # two share a pixel, one is behind
    assert_close(
        seen[3, 48, [64, 84]], torch.tensor([2.0, 0.8])
    )  # 1/2 and 1/5 over their median, 1/4
    assert_close(seen[:3].mean(), 2 * view.load().mean() - 1, atol=0.02, rtol=0)
    assert not network_input(view, points[:0])[3:].any()


def test_the_loss_knows_no_scale_and_no_zero_and_counts_what_is_known():
    generator = torch.Generator().manual_seed(0)
    truth = torch.rand(2, 6, 8, generator=generator) + 0.1
    known = torch.rand(2, 6, 8, generator=generator) > 0.3
    assert_close(affine_loss(3 * truth - 7, truth, known), torch.tensor(0.0), atol=1e-5, rtol=0)
    spoilt = torch.where(known, truth, 99.0)
    assert_close(affine_loss(spoilt, truth, known), torch.tensor(0.0), atol=1e-5, rtol=0)
    assert affine_loss(torch.rand(2, 6, 8, generator=generator), truth, known) > 0.5
    # a truth less its mean over its deviation, and its negative: twice its mean absolute value, 1
    assert_close(affine_loss(-truth, truth, known), torch.tensor(2.0), atol=1e-5, rtol=0)


def test_a_plane_seen_straight_on_teaches_nothing():
    truth, known = torch.full((1, 6, 8), 0.3), torch.ones(1, 6, 8, dtype=torch.bool)
    truth[0, 0, 0] += 1e-9
    said = torch.rand(1, 6, 8, generator=torch.Generator().manual_seed(0)).requires_grad_()
    affine_loss(said, truth, known).backward()
    assert said.grad is not None
    assert said.grad.isfinite().all()


def test_a_short_training_learns_and_is_the_same_again(monkeypatch, tmp_path):
    monkeypatch.setattr(network, "LONGER", 32)
    scene = plane_scene()
    samples = samples_of(replace(scene, train=scene.train[:2]))
    losses: list[float] = []
    first = train(samples, steps=12, batch=2, report=lambda step, steps, loss: losses.append(loss))
    assert sum(losses[-3:]) < 0.7 * sum(losses[:3])
    again = train(samples, steps=12, batch=2)
    path = tmp_path / "net.safetensors"
    save_network(path, first, {"steps": 12})
    for mine, other in zip(first.parameters(), again.parameters(), strict=True):
        assert torch.equal(mine, other)
    prior = network.prepare(scene.for_training(), path, 0)(1)
    assert prior.disparity.shape == (18, 24)
    assert prior.valid.all()
    known = samples[0].known
    with torch.inference_mode():
        said = first(samples[0].given[None])
    # a constant has 1; 0.28 was seen after these few steps
    assert affine_loss(said, samples[0].truth[None], known[None]) < 0.4
    assert torch.equal(load_network(path)(samples[0].given[None]), first(samples[0].given[None]))


def test_files_of_something_else_are_refused(tmp_path):
    path = tmp_path / "net.safetensors"
    write_tensors(path, {"a": torch.ones(2)}, {"format": network.FORMAT})
    with pytest.raises(
        DataError,
        match="not the weights that are expected .*depth network.*bench train-prior depth",
    ):
        load_network(path)
    write_tensors(path, DepthNetwork().state_dict(), {"format": "other"})
    with pytest.raises(DataError, match="not the weights"):
        load_network(path)


def test_missing_and_damaged_weights_say_what_to_do(tmp_path, monkeypatch):
    path = tmp_path / "net.safetensors"
    for content in (None, b"x"):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(DataError, match=r"net\.safetensors: no.*; `bench train-prior depth`"):
            load_network(path)
        with pytest.raises(DataError, match=r"net\.safetensors: no.*; `bench train-prior`"):
            load_facts(path)
    monkeypatch.setattr(unet, "PACKAGED", tmp_path)
    for load in (load_network, load_facts):
        with pytest.raises(DataError, match=r"net\.safetensors: .*; .*install splatproof again"):
            load(path)


def test_training_wants_truth_and_views():
    blind = plane_scene().for_training()
    with pytest.raises(DataError, match="has no true depth to train on"):
        network_training.samples_of(blind)
    with pytest.raises(DataError, match="no views"):
        train([], steps=1)


def test_the_shipped_weights_are_those_of_their_record():
    record = json.loads(network.SHIPPED.with_suffix(".json").read_text())
    assert record["sha256"] == sha256(network.SHIPPED)
    assert record["bytes"] == network.SHIPPED.stat().st_size <= MOST_BYTES
    assert record["command"].startswith("bench train-prior depth depth.safetensors --worlds ")
    facts = load_facts(network.SHIPPED)
    assert {name: record[name] for name in ("worlds", "seeds", "steps", "preset")} == {
        name: facts[name] for name in ("worlds", "seeds", "steps", "preset")
    }
    assert record["loss"][-1] < 0.6 * record["loss"][0]
    load_network(network.SHIPPED)


def test_no_registered_scene_is_of_a_seed_that_was_trained_on():
    seeds = load_facts(network.SHIPPED)["seeds"]
    assert not {entry.seed for entry in list_scenes()} & set(seeds)


def test_a_record_says_whether_the_network_knows_such_scenes(tmp_path):
    path, scene = tmp_path / "net.safetensors", plane_scene()
    save_network(path, DepthNetwork(), {"worlds": ["city", "street"]})

    def said(world: str | None) -> str:
        facts = {} if world is None else {"world": world}
        return unet.domain(replace(scene, facts=facts), path)

    assert said("city") == "in domain: trained on city, street, used on city"
    assert said("tunnel") == "out of domain: trained on city, street, used on tunnel"
    assert said(None) == "out of domain: trained on city, street, used on photos"


def test_the_shipped_prior_needs_no_path_and_is_in_facts_with_its_domain(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path))
    monkeypatch.setattr(network, "LONGER", 32)
    facts = with_priors(plane_scene(), "own", 0).facts
    assert facts["depth_prior"] == "own"
    assert facts[WEIGHTS] == sha256(network.SHIPPED)
    assert facts["depth_prior_domain"].startswith("out of domain: trained on courtyard, city")
