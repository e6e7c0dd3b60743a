"""Training of the refiner: where its samples come from, that it learns, and what it refuses."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs import refiner_training
from splatproof.methods.dpgs.refiner_training import Sample, errors, samples_of, train
from splatproof.methods.dpgs.side_views import Guide
from splatproof.methods.priors.view_refiner import refiner_input
from splatproof.methods.threedgs.fit import fit
from splatproof.methods.threedgs.settings import ThreeDGS


@pytest.fixture
def _small(monkeypatch) -> None:
    monkeypatch.setattr(refiner_training, "CROP", 16)


def wrong(seed: int, count: int = 3) -> list[Sample]:
    """Views whose warp is a third too dark where there is no evidence: the right half."""
    generator, found = torch.Generator().manual_seed(seed), []
    for _ in range(count):
        truth = 0.3 + 0.5 * torch.rand(3, 16, 24, generator=generator)
        counted = torch.zeros(16, 24, dtype=torch.bool)
        counted[:, 12:] = True
        dark = torch.where(counted, truth * 0.66, truth)
        given = 2 * torch.cat([0.9 * dark, dark, torch.ones(2, 16, 24)]) - 1
        found.append(Sample(given=given, truth=truth, counted=counted))
    return found


def test_samples_are_held_out_views_as_models_of_the_training_views_draw_them():
    scene = tiny_scene()
    samples = samples_of(scene, steps=3)
    height, width = scene.test_views[0].size
    assert [one.given.shape for one in samples] == [
        (8, height, width)
    ] * 2  # an early and a late one
    for one in samples:
        assert torch.equal(one.truth.permute(1, 2, 0), scene.test_views[0].load())
        assert one.counted.any()
        assert one.given.abs().max() <= 1
    assert not torch.equal(samples[0].given, samples[1].given)
    early = fit(
        scene, ThreeDGS(iterations=3, dense_cell=4.0, random_points=10_000), Run(seed=0, threads=1)
    )
    guide = Guide(scene.train_views, early.render)
    ((side, proven, best),) = guide.of([scene.test_views[0].camera])
    assert torch.equal(samples[0].given, refiner_input(side, guide.texture(best)))
    assert torch.equal(samples[0].counted, ~proven)
    blind = replace(scene, test=())
    with pytest.raises(DataError, match="no held-out views"):
        samples_of(blind, steps=3)


@pytest.mark.usefixtures("_small")
def test_it_learns_what_is_wrong_where_nobody_looked():
    losses = []
    first = train(wrong(0), steps=28, report=lambda step, steps, loss: losses.append(loss))
    assert sum(losses[-5:]) < 0.5 * sum(losses[:5])
    found = errors(first, wrong(1))
    assert found["own"] < 0.6 * found["warp"] < 0.6 * found["render"]


def test_errors_are_counted_where_there_is_no_evidence_alone():
    (one,) = wrong(0, 1)
    found = errors(None, [one])
    assert found["warp"] == pytest.approx(float(0.34 * one.truth[:, :, 12:].mean()), rel=1e-4)
    spoilt = one.given.clone()
    spoilt[:, :, :12] = 0
    assert errors(None, [replace(one, given=spoilt)]) == pytest.approx(found)


@pytest.mark.usefixtures("_small")
def test_what_has_evidence_everywhere_or_is_too_small_is_not_trained_on():
    (one,) = wrong(0, 1)
    for odd in (
        replace(one, counted=torch.zeros_like(one.counted)),
        Sample(given=one.given[:, :9], truth=one.truth[:, :9], counted=one.counted[:9]),
    ):
        with pytest.raises(DataError, match="no side views of 16 pixels"):
            train([odd], steps=1)


@pytest.mark.usefixtures("_small")
def test_what_photos_prove_teaches_nothing_and_equal_seeds_learn_the_same():
    samples = wrong(0)
    spoilt = [replace(one, truth=torch.where(one.counted, one.truth, 0.0)) for one in samples]
    one, again, other = (train(given, steps=4) for given in (samples, samples, spoilt))
    for same in (again, other):
        pairs = zip(one.parameters(), same.parameters(), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)
