"""Our own depth network: what it sees, that it learns, and its weights file."""

from dataclasses import replace

import pytest
import torch
import train_depth_network
from torch.testing import assert_close

from helpers.prior_scenes import plane_scene
from splatproof.base.errors import DataError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.priors import network, network_training
from splatproof.methods.priors.network import (
    DepthNetwork,
    load_network,
    network_input,
    save_network,
)
from splatproof.methods.priors.network_training import affine_loss, samples_of, train
from splatproof.reference.types.scene import View


def test_it_has_as_many_parameters_as_it_says():
    count = sum(values.numel() for values in DepthNetwork().parameters())
    assert 0.75e6 < count < 0.85e6


def test_it_sees_the_photo_and_the_nearest_of_the_points_of_a_pixel():
    view: View = plane_scene().views[1]
    eye, ahead = view.camera.centre, view.camera.rotation[2]
    points = torch.stack([eye + 2 * ahead, eye + 4 * ahead, eye - ahead])
    seen = network_input(view, points)
    assert seen.shape == (5, 96, 128)
    assert int(seen[4].sum()) == 1  # both on the axis, and one behind
    row, column = (int(x) for x in seen[4].nonzero()[0])
    assert (row, column) == (48, 64)
    assert_close(seen[3, row, column], torch.tensor(2.0))  # 1/2 over the lower median, 1/4
    assert_close(seen[:3].mean(), 2 * view.load().mean() - 1, atol=0.02, rtol=0)
    assert not network_input(view, points[:0])[3:].any()


def test_the_loss_knows_no_scale_and_no_zero_and_counts_what_is_known():
    generator = torch.Generator().manual_seed(0)
    truth = torch.rand(2, 6, 8, generator=generator) + 0.1
    known = torch.rand(2, 6, 8, generator=generator) > 0.3
    assert_close(affine_loss(3 * truth - 7, truth, known), torch.tensor(0.0), atol=1e-5, rtol=0)
    spoilt = torch.where(known, truth, 99.0)
    assert_close(affine_loss(spoilt, truth, known), torch.tensor(0.0), atol=1e-5, rtol=0)
    assert affine_loss(torch.rand(2, 6, 8, generator=generator), truth, known) > 0.1


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
    assert affine_loss(said, samples[0].truth[None], known[None]) < 0.2
    assert torch.equal(load_network(path)(samples[0].given[None]), first(samples[0].given[None]))


def test_files_of_something_else_are_refused(tmp_path):
    path = tmp_path / "net.safetensors"
    write_tensors(path, {"a": torch.ones(2)}, {"format": network.FORMAT})
    with pytest.raises(DataError, match="not the weights of a depth network.*train_depth_network"):
        load_network(path)
    write_tensors(path, DepthNetwork().state_dict(), {"format": "other"})
    with pytest.raises(DataError, match="not the weights"):
        load_network(path)


def test_training_wants_truth_and_views():
    blind = plane_scene().for_training()
    with pytest.raises(DataError, match="has no true depth to train on"):
        network_training.samples_of(blind)
    with pytest.raises(DataError, match="no views"):
        train([], steps=1)


def test_the_program_trains_on_worlds_of_unused_seeds(monkeypatch, tmp_path):
    made: list[tuple[str, str, int]] = []

    def make(world, preset, seed, folder, report):
        made.append((world, preset, seed))
        return folder

    monkeypatch.setattr(network, "LONGER", 16)
    monkeypatch.setattr(train_depth_network, "make", make)
    monkeypatch.setattr(train_depth_network, "open_scene", lambda folder, protocol: plane_scene())
    out = tmp_path / "net.safetensors"
    train_depth_network.main([str(out), "--worlds", "street", "--seeds", "2", "--steps", "1"])
    assert made == [("street", "small", 1000), ("street", "small", 1001)]
    _, facts = read_tensors(out)
    assert facts["seeds"] == [1000, 1001]
    assert facts["steps"] == 1
    load_network(out)
