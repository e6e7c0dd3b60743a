"""Training of our own matcher: what it is told, that it learns, and what cannot be learnt from."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from helpers.textured_scene import textured_scene
from splatproof.base.errors import DataError
from splatproof.methods.priors import own_matcher_training
from splatproof.methods.priors.own_matcher import FINE, MIDDLE, MatchNetwork, Said
from splatproof.methods.priors.own_matcher_training import (
    Sample,
    errors,
    loss_of,
    part,
    samples_of,
    shown,
    train,
)
from splatproof.methods.priors.plane_sweep import pixels, positions


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return samples_of(textured_scene())


def test_pairs_are_learnt_both_ways_with_the_true_planes(samples):
    assert len(samples) == 6
    scene = textured_scene()
    assert scene.views[0].load_depth is not None
    pair, known = samples[0].pair, samples[0].known
    inverse = samples[0].truth * (pixels(*known.shape) @ pair.planes.slope)
    assert_close(inverse[known].float(), 1 / scene.views[0].load_depth()[known])
    assert_close(samples[0].truth[known], torch.ones(int(known.sum())), atol=1e-3, rtol=0)
    assert 0.5 < float(known.double().mean()) < 1
    assert not samples[0].truth[~known].any()
    assert not (known & ~pair.covered).any()  # the wall is the middle plane itself


def test_what_the_other_photo_does_not_show_is_not_learnt():
    scene = textured_scene()
    a, b = scene.views[0], scene.views[1]
    assert a.load_depth is not None
    assert b.load_depth is not None
    depth, other = a.load_depth(), b.load_depth()
    assert shown(a.camera, b.camera, depth, other)[1][24, 24]
    other[:, :40] *= 0.9  # something stands before it
    at, seen = shown(a.camera, b.camera, depth, other)
    assert not seen[at[..., 0] < 39].any()
    assert seen[(at[..., 0] > 41) & (at[..., 0] < 63) & (at[..., 1] > 1) & (at[..., 1] < 47)].all()


def said_right(sample: Sample, off: int = 0) -> Said:
    """Logits of the plane nearest to the truth, or of one that is `off` from it, in both sweeps."""
    scales, step = sample.pair.planes.scales.float(), 0.02
    height, width = sample.known.shape
    coarse = torch.full((len(scales), height // 4, width // 4), -20.0)
    number = ((sample.truth[2::4, 2::4] - scales[0]) / (scales[1] - scales[0])).round().long()
    coarse.scatter_(0, (number + off).clamp(0, len(scales) - 1)[None], 20.0)
    fine = torch.full((FINE, height, width), -20.0)
    fine[MIDDLE + off] = 20.0
    return Said(coarse=coarse, fine=fine, start=sample.truth, step=step)


def test_the_loss_is_least_where_the_truth_is_said(samples):
    sample = samples[0]
    scales = sample.pair.planes.scales.float()
    # planes of the first sweep are whole numbers here
    whole = scales[2] * torch.ones_like(sample.truth)
    sample = replace(sample, truth=whole)
    assert float(loss_of(said_right(sample), scales, sample)) == pytest.approx(0, abs=1e-4)
    # 40 off in both entropies, and an answer one plane off: half of 1 - 1/2
    assert float(loss_of(said_right(sample, 1), scales, sample)) == pytest.approx(80.25, abs=1e-2)
    hidden = replace(sample, known=torch.zeros_like(sample.known))
    assert float(loss_of(said_right(sample, 1), scales, hidden)) == 0
    beyond = replace(sample, truth=10 * whole)
    said = said_right(sample)
    assert float(loss_of(said, scales, beyond)) == 0  # among no plane


def test_a_short_training_learns_and_is_the_same_again(samples, monkeypatch):
    monkeypatch.setattr(own_matcher_training, "CROP", (32, 32))
    fresh, first, again = (train(samples, steps=steps) for steps in (1, 10, 10))
    seen, scales = samples[0], samples[0].pair.planes.scales.float()
    with torch.no_grad():
        before, taught = (
            float(loss_of(network(seen.pair), scales, seen)) for network in (fresh, first)
        )
    assert taught < 0.96 * before  # 0.936 was seen
    for mine, other in zip(first.parameters(), again.parameters(), strict=True):
        assert torch.equal(mine, other)
    drawn = train(samples, steps=1, seed=1)
    assert not torch.equal(fresh.far.weight, drawn.far.weight)


def test_a_part_is_told_of_matches_within_it_alone(samples, monkeypatch):
    monkeypatch.setattr(own_matcher_training, "CROP", (32, 40))
    whole = samples[0]
    known = torch.ones_like(whole.known)
    moved = whole.pair.planes.scales[-1] * torch.ones_like(whole.truth).double()
    whole = replace(whole, truth=moved.float(), known=known)
    kept = part(whole, torch.Generator().manual_seed(0))
    rows, columns = next(
        (row, column)
        for row in range(17)
        for column in range(25)
        if torch.equal(whole.pair.photo[:, row : row + 32, column : column + 40], kept.pair.photo)
    )
    assert rows + columns > 0
    there = positions(whole.pair.planes, pixels(*known.shape), whole.truth[None])[0]
    corner = there.new_tensor([columns, rows])
    there = there[rows : rows + 32, columns : columns + 40] - corner
    at = positions(kept.pair.planes, pixels(32, 40), kept.truth[None])[0]
    assert_close(at, there, atol=1e-9, rtol=0)
    assert torch.equal(kept.known, ((at >= 0) & (at < at.new_tensor([40, 32]))).all(dim=-1))
    assert 0 < float(kept.known.double().mean()) < 1
    plane = pixels(*known.shape) @ whole.pair.planes.slope
    assert_close(
        pixels(32, 40) @ kept.pair.planes.slope, plane[rows : rows + 32, columns : columns + 40]
    )


def test_both_matchers_are_held_against_the_truth():
    torch.manual_seed(0)
    found = errors(MatchNetwork().eval(), textured_scene())
    assert set(found) == {"flow", "own"}
    assert 0.3 < found["flow"]["sure"] <= 1
    assert found["flow"]["median"] < 0.5
    assert 0 <= found["own"]["sure"] <= 1


def test_training_wants_truth_and_pairs():
    with pytest.raises(DataError, match="has no true depth to train on"):
        samples_of(textured_scene().for_training())
    lone = replace(textured_scene(), train=(0,))
    assert samples_of(lone) == []
    with pytest.raises(DataError, match="no pairs of photos to train the matcher on"):
        train([], steps=1)
    with pytest.raises(DataError, match="no pairs of photos to compare"):
        errors(MatchNetwork(), lone)
