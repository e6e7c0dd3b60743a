"""Our own refiner of side views: what it sees, that untrained it is the warp, and its weights file."""

import json

import pytest
import torch
from torch.testing import assert_close

from helpers.tiny_scene import camera
from splatproof.base.errors import DataError
from splatproof.base.files import sha256
from splatproof.base.tensor_files import write_tensors
from splatproof.cli.train_prior import MOST_BYTES
from splatproof.datasets.catalogue.registry import list_scenes
from splatproof.methods.priors import view_refiner
from splatproof.methods.priors.unet import STRIDE, load_facts
from splatproof.methods.priors.view_refiner import (
    OwnRefiner,
    RefinerNetwork,
    load_refiner,
    refiner_input,
    save_refiner,
)
from splatproof.reference.supervision.side_views import SeenView, sees, warp_and_fill


def seen(index: int, seed: int) -> SeenView:
    """A wall at depth 4 with a hole, before one of the tiny scene's cameras."""
    where, generator = camera(index), torch.Generator().manual_seed(seed)
    alpha = torch.ones(where.height, where.width)
    alpha[:, :5] = 0.1
    return SeenView(
        camera=where, image=torch.rand(where.height, where.width, 3, generator=generator),
        alpha=alpha, depth=torch.full((where.height, where.width), 4.0),
    )  # fmt: skip


def shaken() -> RefinerNetwork:
    network, generator = RefinerNetwork(), torch.Generator().manual_seed(1)
    with torch.no_grad():
        network.last.weight.copy_(0.1 * torch.randn(3, 16, 1, 1, generator=generator))
    return network.eval()


def test_it_has_as_many_parameters_as_it_says():
    count = sum(values.numel() for values in RefinerNetwork().parameters())
    assert 0.35e6 < count < 0.45e6


def test_it_sees_the_render_the_warp_and_where_they_can_be_trusted():
    side, photo = seen(2, 0), seen(3, 1)
    given = (refiner_input(side, photo) + 1) / 2
    assert_close(given[:3].permute(1, 2, 0), side.image)
    assert_close(given[3:6].permute(1, 2, 0), warp_and_fill(side, photo))
    assert_close(given[6], side.alpha)
    assert torch.equal(given[7] > 0.5, sees(photo, side))
    assert 0 < given[7].mean() < 1


def test_untrained_it_is_the_warp():
    side, photo = seen(2, 0), seen(3, 1)
    refine = OwnRefiner(RefinerNetwork().eval())
    assert_close(refine(side, photo), warp_and_fill(side, photo))


def test_a_view_of_any_size_is_refined_within_range():
    side, photo = seen(2, 0), seen(3, 1)
    assert side.alpha.shape[0] % STRIDE
    found = OwnRefiner(shaken())(side, photo)
    assert found.shape == side.image.shape
    assert 0 <= found.min() <= found.max() <= 1
    assert not torch.allclose(found, warp_and_fill(side, photo), atol=1e-3)


def test_weights_come_back_as_they_were(tmp_path):
    path, network = tmp_path / "refiner.safetensors", shaken()
    save_refiner(path, network, {"worlds": ["city"]})
    side, photo = seen(2, 0), seen(3, 1)
    again = OwnRefiner(load_refiner(path))(side, photo)
    assert torch.equal(again, OwnRefiner(network)(side, photo))
    assert load_facts(path)["worlds"] == ["city"]
    write_tensors(path, {"a": torch.ones(2)}, {"format": view_refiner.FORMAT})
    with pytest.raises(DataError, match="view refiner 1.*bench train-prior refiner"):
        load_refiner(path)


def test_the_shipped_weights_are_those_of_their_record_and_help_on_worlds_apart():
    record = json.loads(view_refiner.SHIPPED.with_suffix(".json").read_text())
    assert record["sha256"] == sha256(view_refiner.SHIPPED)
    assert record["bytes"] == view_refiner.SHIPPED.stat().st_size <= MOST_BYTES
    assert record["command"].startswith("bench train-prior refiner refiner.safetensors --worlds ")
    facts = load_facts(view_refiner.SHIPPED)
    named = ("worlds", "seeds", "steps", "preset", "model_steps")
    assert {name: record[name] for name in named} == {name: facts[name] for name in named}
    assert record["loss"][-1] < record["loss"][0]
    apart = record["error_apart"]
    assert apart["own"] < 0.95 * min(apart["warp"], apart["render"])
    load_refiner()


def test_no_registered_scene_is_of_a_seed_that_was_trained_on():
    seeds = load_facts(view_refiner.SHIPPED)["seeds"]
    assert not {entry.seed for entry in list_scenes()} & {*seeds, seeds[-1] + 1}
