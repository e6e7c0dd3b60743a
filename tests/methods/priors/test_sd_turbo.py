"""Stable Diffusion Turbo as a refiner, tried with a tiny one of random weights; its attention, by hand."""

import sys
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from helpers import tiny_diffusers
from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.fit import fit
from splatproof.methods.dpgs.settings import Dpgs, SideSettings
from splatproof.methods.priors import sd_turbo
from splatproof.methods.priors.sd_turbo import JoinedAttention, SdTurboRefiner
from splatproof.reference.supervision.side_views import SeenView

NOISY = pytest.mark.filterwarnings("default")
"""What the library warns of differs with its version and is not ours."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setattr(sd_turbo, "SIDE", 64)
    return tiny_diffusers.sd_turbo(tmp_path)


def seen(index: int, seed: int) -> SeenView:
    where, generator = camera(index), torch.Generator().manual_seed(seed)
    return SeenView(
        camera=where, image=torch.rand(where.height, where.width, 3, generator=generator),
        alpha=torch.ones(where.height, where.width), depth=torch.full((where.height, where.width), 4.0),
    )  # fmt: skip


@NOISY
def test_a_side_view_is_drawn_again_in_its_size_and_the_same_each_time(folder):
    refine = SdTurboRefiner(folder, reference=True)
    side, photo = seen(2, 0), seen(3, 1)
    image = refine(side, photo)
    assert image.shape == side.image.shape
    assert 0 <= float(image.min()) <= float(image.max()) <= 1
    assert image.std() > 0
    assert torch.equal(image, refine(side, photo))
    assert not torch.equal(image, refine(seen(2, 5), photo))


@NOISY
def test_the_photo_guides_it_unless_it_is_to_see_none(folder):
    guided, alone = (SdTurboRefiner(folder, reference=given) for given in (True, False))
    side = seen(2, 0)
    assert not torch.equal(guided(side, seen(3, 1)), guided(side, seen(3, 2)))
    assert torch.equal(alone(side, seen(3, 1)), alone(side, seen(3, 2)))
    other = torch.rand(40, 30, 3), torch.ones(40, 30), torch.ones(40, 30)
    larger = SeenView(
        camera=camera(3, width=30, height=40), image=other[0], alpha=other[1], depth=other[2]
    )
    assert guided(side, larger).shape == side.image.shape


def test_the_side_view_sees_the_tokens_of_both_and_the_photo_its_own():
    def plain(layer, tokens, keys=None):
        keys = tokens if keys is None else keys
        return torch.softmax(tokens @ keys.mT, dim=-1) @ keys

    tokens = torch.randn(2, 5, 3, generator=torch.Generator().manual_seed(0))
    side, photo = JoinedAttention(plain)(None, tokens)
    both = tokens.reshape(10, 3)
    assert_close(side, torch.softmax(tokens[0] @ both.T, dim=-1) @ both)
    assert_close(photo, torch.softmax(tokens[1] @ tokens[1].T, dim=-1) @ tokens[1])


def test_an_image_is_enlarged_to_the_networks_size_and_its_border_repeated():
    image = torch.rand(18, 24, 3)
    whole = sd_turbo._sized(image, (18, 24))
    assert whole.shape == (1, 3, 512, 704)  # 683 columns of the image
    assert torch.equal(whole[..., 683:], whole[..., 682:683].expand(1, 3, 512, 21))
    assert sd_turbo._sized(torch.rand(600, 700, 3), (600, 700)).shape == (1, 3, 640, 704)
    assert sd_turbo._sized(image, (512, 512)).shape == (1, 3, 512, 512)


@NOISY
def test_dpgs_trains_on_what_it_draws_and_says_whose_weights(folder):
    side = SideSettings(every=2, refiner="sd-turbo", weights=str(folder))
    facts = {}
    run = Run(seed=0, threads=1, on_fact=facts.__setitem__)
    fit(tiny_scene(), Dpgs(iterations=6, dense_cell=0.0, side=side), run)
    assert facts["refiner"].startswith("weights ")
    assert len(facts["refiner"]) == len("weights ") + 64


@NOISY
def test_what_is_missing_is_told_before_training(tmp_path, monkeypatch):
    side = SideSettings(refiner="sd-turbo", weights=str(tmp_path))
    settings = Dpgs(iterations=6, dense_cell=0.0, side=side)
    if "diffusers" in sys.modules or not _missing():
        with pytest.raises(
            DataError, match="not a folder of a StableDiffusionImg2ImgPipeline"
        ) as error:
            fit(tiny_scene(), settings, Run(seed=0, threads=1))
        assert "\n" not in str(error.value)
    monkeypatch.setitem(sys.modules, "diffusers", None)
    with pytest.raises(MissingError, match=r"install splatproof\[priors\], or take 'warp'"):
        fit(tiny_scene(), settings, Run(seed=0, threads=1))


def _missing() -> bool:
    try:
        tiny_diffusers.of_the_extra("diffusers")
    except pytest.skip.Exception:
        return True
    return False


@pytest.mark.parametrize(("refiner", "weights"), [("sd-turbo", ""), ("warp", "somewhere")])
def test_weights_are_for_the_refiner_that_has_none_of_its_own(refiner, weights):
    with pytest.raises(UsageError, match="side.weights"):
        SideSettings(refiner=refiner, weights=weights)
