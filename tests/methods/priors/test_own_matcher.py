"""Our own matcher: what does not change its matches, that they are right on a wall, and its weights."""

import json
import math

import pytest
import torch
from torch.testing import assert_close

from helpers.textured_scene import textured_scene
from splatproof.base.errors import DataError
from splatproof.base.files import sha256
from splatproof.base.tensor_files import write_tensors
from splatproof.cli.train_prior import MOST_BYTES
from splatproof.datasets.catalogue.registry import list_scenes
from splatproof.methods.priors import own_matcher, plane_sweep, unet
from splatproof.methods.priors.own_matcher import (
    MatchNetwork,
    OwnMatcher,
    agreement,
    estimate,
    load_own_matcher,
    peak,
    save_matcher,
)
from splatproof.methods.priors.plane_sweep import pair_of, pixels
from splatproof.methods.priors.unet import load_facts
from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene


def matched(scene: Scene, matcher: OwnMatcher, a: int = 0, b: int = 1):
    first, second = scene.views[a], scene.views[b]
    return matcher(first.camera, second.camera, first.load(), second.load(), scene.points.positions)


def true_warp(scene: Scene, a: int = 0, b: int = 1) -> torch.Tensor:
    """From the wall's formula."""
    first, second = scene.views[a], scene.views[b]
    assert first.load_depth is not None
    at, _ = project_points(second.camera, unproject(first.camera, first.load_depth().double()))
    size = first.size
    return (at.reshape(*size, 2) - pixels(*size)[..., :2]).float()


@pytest.fixture(scope="module")
def shipped() -> OwnMatcher:
    return load_own_matcher()


def test_it_has_as_many_parameters_as_it_says():
    assert 51_500 < sum(values.numel() for values in MatchNetwork().parameters()) < 52_500


def test_the_answer_is_the_mean_about_the_likeliest_plane():
    chances = torch.full((9, 1, 3), 1e-6)
    chances[[3, 4], 0, 0] = torch.tensor([0.25, 0.75])  # between two
    chances[[2, 7], 0, 1] = torch.tensor([0.6, 0.4])  # two surfaces far apart
    chances[0, 0, 2] = 1.0  # it may lie beyond
    number, sure = peak(chances.log())
    assert_close(number[0], torch.tensor([3.75, 2.0, 0.0]), atol=1e-4, rtol=0)
    assert_close(sure[0], torch.tensor([1.0, 0.6, 0.0]), atol=1e-4, rtol=0)


@torch.no_grad()
def test_brightness_and_contrast_do_not_matter_and_what_does_not_count_is_nothing():
    photo = textured_scene().views[0].load().permute(2, 0, 1)
    torch.manual_seed(0)
    network, counted = MatchNetwork(), torch.ones(photo.shape[1:], dtype=torch.bool)
    usual, other = network.features(photo, counted), network.features(0.5 * photo + 0.2, counted)
    for one, two in zip(usual, other, strict=True):
        # DARKEST is 0.4 % of the stretching at half this contrast; 0.003 was seen
        assert_close(one, two, atol=5e-3, rtol=0)
    curved = network.features(photo**2, counted)[1]
    assert float((curved - usual[1]).abs().max()) > 0.1  # the control
    counted[:, :32] = False
    coarse, fine = network.features(photo, counted)
    assert not coarse[:, :, :8].any()
    assert not fine[:, :, :32].any()
    assert fine[:, :, 32:].any()


@pytest.mark.parametrize("turn", [0.0, 90.0])
def test_a_wall_is_matched_within_a_pixel_from_any_side(shipped, turn):
    scene = textured_scene(turn)
    warp, certainty = matched(scene, shipped)
    true, sure = true_warp(scene), certainty > 0.3
    assert 0 <= float(certainty.min()) <= float(certainty.max()) <= 1
    assert float(sure.double().mean()) > 0.3
    off = (warp - true).norm(dim=-1)[sure]
    assert float(off.median()) < 0.3
    # chance: the planes' own middle for every pixel of another depth
    assert float((off < 1).double().mean()) > 0.9


def test_swapped_photos_give_the_way_back(shipped):
    scene = textured_scene()
    there, sure = matched(scene, shipped)
    back, _ = matched(scene, shipped, 1, 0)
    at = (pixels(*sure.shape)[..., :2] + there)[sure > 0.5]
    column, row = at.floor().long().T
    returned = there[sure > 0.5] + back[row, column]
    assert float(returned.norm(dim=-1).median()) < 0.5
    assert float(there.norm(dim=-1).median()) > 3  # the control


def test_the_scenes_unit_leaves_matches_alone(shipped):
    usual, other = matched(textured_scene(), shipped), matched(textured_scene(unit=100), shipped)
    for here, there in zip(other, usual, strict=True):
        off = (here - there).abs()
        # where two planes are as likely, rounding says about which of them the answer is: on one machine
        # at one pixel, by 0.05 pixels
        assert float((off > 2e-3).float().mean()) < 1e-3
        assert float(off.max()) < 0.2


def test_larger_photos_are_matched_in_their_own_pixels(shipped, monkeypatch):
    scene = textured_scene()
    monkeypatch.setattr(plane_sweep, "LONGEST", 48)
    warp, certainty = matched(scene, shipped)
    assert warp.shape == (*scene.views[0].size, 2)
    off = (warp - true_warp(scene)).norm(dim=-1)[certainty > 0.3]
    assert len(off) > 300
    assert float(off.median()) < 0.5


def test_depths_that_lead_back_agree_and_others_do_not():
    scene = textured_scene()
    a, b = scene.views[0], scene.views[1]
    assert a.load_depth is not None
    assert b.load_depth is not None
    here, there = 1 / a.load_depth().double(), 1 / b.load_depth().double()
    true = true_warp(scene) + pixels(*a.size)[..., :2]
    size = torch.tensor([b.camera.width, b.camera.height])
    inside = ((true >= 0) & (true < size)).all(dim=-1)
    well = ((true >= 1) & (true < size - 1)).all(dim=-1)  # not read off the edge
    found = agreement(a.camera, b.camera, here, there)
    assert_close(found[well], torch.ones(int(well.sum())).double(), atol=1e-3, rtol=0)
    assert not found[~inside].any()
    # B's depth 2 % too large moves the match back by 2 % of the parallax, f times baseline over depth
    spoilt = agreement(a.camera, b.camera, here, there / 1.1)
    row, column = 24, 28
    moved = -torch.log(spoilt[row, column]) * 2
    parallax = 70 * math.hypot(0.5, 0.1) * float(here[row, column])
    assert float(moved.sqrt()) == pytest.approx(parallax * (1 - 1 / 1.1), rel=0.05)


@torch.no_grad()
def test_the_second_sweep_is_finer_and_about_what_the_first_found():
    scene = textured_scene()
    a, b = scene.views[0], scene.views[1]
    pair = pair_of(a.camera, b.camera, a.load(), b.load(), scene.points.positions)
    assert pair is not None
    network, swept = MatchNetwork(), []

    def third(level, here, there, planes, at, scales):
        swept.append(scales)
        logits = torch.full(scales.shape, -50.0)
        logits[3] = 50.0  # of both sweeps
        return logits

    network._swept = third
    inverse, sure = estimate(network, pair)
    first, second = swept
    step = (first[1] - first[0])[0, 0]
    assert_close(second[own_matcher.MIDDLE], first[3, 0, 0].expand_as(second[0]))
    assert_close(second[1:] - second[:-1], (step / own_matcher.FINER).expand_as(second[1:]))
    said = inverse / (pixels(*sure.shape) @ pair.planes.slope)
    assert_close(said.float(), second[3])
    assert_close(sure, torch.ones_like(sure))


def test_what_the_other_photo_says_otherwise_is_not_sure(monkeypatch):
    scene = textured_scene()
    a, b = scene.views[0], scene.views[1]
    assert a.load_depth is not None
    assert b.load_depth is not None
    for share, least, most in ((1.0, 0.99, 1.0), (1.5, 0.0, 0.2)):
        depths = iter([a.load_depth(), b.load_depth() * share])

        def says(network, pair, depths=depths):
            depth = next(depths).double()
            return 1 / depth, torch.ones_like(depth).float()

        monkeypatch.setattr(own_matcher, "estimate", says)
        certainty = matched(scene, OwnMatcher(MatchNetwork()))[1]
        assert least <= float(certainty[12:-12, 20:-12].min())
        assert float(certainty[12:-12, 20:-12].max()) <= most


def test_photos_that_share_nothing_are_not_matched(shipped):
    scene = textured_scene()
    a, b = scene.views[0], scene.views[1]
    nothing = scene.points.positions[:0]
    warp, certainty = shipped(a.camera, b.camera, a.load(), b.load(), nothing)
    assert warp.shape == (*a.size, 2)
    assert not certainty.any()


def test_weights_come_back_as_they_were_and_others_are_refused(tmp_path, monkeypatch):
    path, scene = tmp_path / "m.safetensors", textured_scene()
    torch.manual_seed(1)
    network = MatchNetwork().eval()
    save_matcher(path, network, {"worlds": ["city"]})
    again = load_own_matcher(path)
    for one, two in zip(matched(scene, again), matched(scene, OwnMatcher(network)), strict=True):
        assert torch.equal(one, two)
        assert one.isfinite().all()
    assert load_facts(path)["worlds"] == ["city"]
    write_tensors(path, {"a": torch.ones(2)}, {"format": own_matcher.FORMAT})
    with pytest.raises(DataError, match=r"splatproof matcher 1.*bench train-prior matcher"):
        load_own_matcher(path)
    path.write_bytes(b"x")
    monkeypatch.setattr(unet, "PACKAGED", tmp_path)
    for place in (path, tmp_path / "none.safetensors"):
        with pytest.raises(DataError, match=r"safetensors: .*install splatproof again") as told:
            load_own_matcher(place)
        assert "\n" not in str(told.value)


def test_the_shipped_weights_are_those_of_their_record():
    record = json.loads(own_matcher.SHIPPED.with_suffix(".json").read_text())
    assert record["sha256"] == sha256(own_matcher.SHIPPED)
    assert record["bytes"] == own_matcher.SHIPPED.stat().st_size <= MOST_BYTES
    assert record["command"].startswith("bench train-prior matcher matcher.safetensors --worlds ")
    facts = load_facts(own_matcher.SHIPPED)
    named = ("worlds", "seeds", "steps", "preset")
    assert {name: record[name] for name in named} == {name: facts[name] for name in named}
    assert record["loss"][-1] < 0.7 * record["loss"][0]
    assert set(record["apart"]) == set(record["worlds"])


def test_no_registered_scene_is_of_a_seed_that_was_trained_on():
    seeds = load_facts(own_matcher.SHIPPED)["seeds"]
    assert not {entry.seed for entry in list_scenes()} & {*seeds, seeds[-1] + 1}
