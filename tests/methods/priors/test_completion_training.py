"""Points as matched photos leave them, and the completion network: what is drawn, that it learns, its shipped file."""

import json
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.prior_scenes import plane_scene
from splatproof.base.files import sha256
from splatproof.cli.train_prior import MOST_BYTES
from splatproof.datasets.catalogue.registry import list_scenes
from splatproof.methods.priors import completion_training, network
from splatproof.methods.priors.completion_training import errors, matched_points
from splatproof.methods.priors.network_training import samples_of, train
from splatproof.methods.priors.unet import load_facts


def drawn(seed: int, count: int = 3, size: tuple[int, int] = (24, 32)):
    """A batch of smooth disparities with a sky above, and its points."""
    draw = torch.Generator().manual_seed(seed)
    rows = torch.linspace(0, 1, size[0])[None, :, None]
    truth = 0.2 + rows.expand(count, *size).clone()
    known = torch.ones(count, *size, dtype=torch.bool)
    known[:, :4] = False
    truth[~known] = 0
    known[:, :2] = True  # a sky that is known to be one
    given_to = torch.full((count, 5, *size), 7.0)
    matched_points(given_to, truth, known, draw)
    return given_to, truth, known


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_points_lie_where_something_is_and_say_its_disparity_but_for_a_few(seed):
    seen, truth, _ = drawn(seed)
    assert bool((seen[:, :3] == 7).all()), "the photo is left alone"
    mask = seen[:, 4] > 0
    assert not (mask & (truth == 0)).any()
    assert not seen[:, 3][~mask].any()
    for sparse, at, true in zip(seen[:, 3], mask, truth, strict=True):
        if at.sum() < 20:
            continue
        assert_close(sparse[at].median(), torch.tensor(1.0))
        ratio = sparse[at] / true[at]
        off = (ratio / ratio.median() - 1).abs()
        assert float((off > 0.05).float().mean()) < 0.25  # 2 % are wrong; five deviations are 5 %
    again, _, _ = drawn(seed)
    assert torch.equal(seen, again)


def test_some_photos_have_no_point_and_none_has_too_many():
    masks = drawn(0, count=400)[0][:, 4] > 0
    shares = masks.flatten(1).float().mean(dim=1)
    none = float((shares == 0).float().mean())
    # a tenth is drawn without; at a share of 0.3 % of few pixels some others have none by chance
    assert 0.08 < none < 0.3
    assert float(shares.max()) < 0.25 * 20 / 24 + 0.08


def test_points_lie_in_regions():
    """Dots that know nothing of each other vary between blocks of 64 pixels by s (1 - s) / 64; regions by far more."""
    masks = drawn(0, count=100, size=(96, 128))[0][:, 4, 8:] > 0  # without the sky
    dotted = masks[masks.flatten(1).float().mean(dim=1) > 0.05].float()
    blocks = dotted.unfold(1, 8, 8).unfold(2, 8, 8).flatten(3).mean(dim=3).flatten(1)
    share = blocks.mean(dim=1)
    ratio = blocks.var(dim=1) / (share * (1 - share) / 64)
    assert float(ratio.median()) > 3


def test_a_short_training_learns_and_beats_the_nearest_point(monkeypatch):
    monkeypatch.setattr(network, "LONGER", 32)
    samples = samples_of(plane_scene())
    losses: list[float] = []
    trained = train(
        samples, steps=40, points=matched_points, batch=2,
        report=lambda step, steps, loss: losses.append(loss),
    )  # fmt: skip
    assert sum(losses[-3:]) < 0.6 * sum(losses[:3])
    found = errors(trained, samples)
    assert 0 < found["own"] < found["nearest"] < 1.2


def test_without_points_the_nearest_is_a_constant(monkeypatch):
    monkeypatch.setattr(network, "LONGER", 32)
    monkeypatch.setattr(completion_training, "WITHOUT_POINTS", 1.0)
    samples = samples_of(replace(scene := plane_scene(), train=scene.train[:1]))
    assert errors(network.DepthNetwork(), samples)["nearest"] == pytest.approx(1.0, abs=1e-5)


def test_the_shipped_weights_are_those_of_their_record_and_know_no_registered_scene():
    file = network.COMPLETION
    record = json.loads(file.with_suffix(".json").read_text())
    assert record["sha256"] == sha256(file)
    assert record["bytes"] == file.stat().st_size <= MOST_BYTES
    assert record["command"].startswith("bench train-prior completion completion.safetensors ")
    facts = load_facts(file)
    assert {name: record[name] for name in ("worlds", "seeds", "steps", "preset")} == {
        name: facts[name] for name in ("worlds", "seeds", "steps", "preset")
    }
    assert record["loss"][-1] < 0.5 * record["loss"][0]
    for found in record["apart"].values():
        assert found["own"] < 0.5 * found["nearest"]
    network.load_network(file)
    kept = {*facts["seeds"], facts["seeds"][-1] + 1}
    assert not {entry.seed for entry in list_scenes()} & kept


def test_the_nearest_point_is_the_nearest():
    seen = torch.zeros(1, 5, 8, 16)
    seen[0, 3:, 4, 2], seen[0, 3:, 4, 13] = torch.tensor([0.5, 1.0]), torch.tensor([2.0, 1.0])
    found = completion_training._nearest(seen)
    assert bool((found[:, :8] == 0.5).all())
    assert bool((found[:, 8:] == 2.0).all())
