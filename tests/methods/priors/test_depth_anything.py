"""A network of transformers from a local folder, tried with a tiny one of random weights."""

import sys
from pathlib import Path

import pytest
import torch

from helpers.prior_scenes import plane_scene
from splatproof.base.errors import DataError, MissingError
from splatproof.methods.priors import depth_anything


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A Depth Anything network of 2 layers and random weights, as the library saves it."""
    library = pytest.importorskip("transformers", reason="the extra 'priors' is not installed")
    torch.manual_seed(0)
    backbone = library.Dinov2Config(
        hidden_size=16, num_hidden_layers=2, num_attention_heads=2, image_size=28, patch_size=14,
        out_features=["stage1", "stage2"], reshape_hidden_states=False, apply_layernorm=True,
    )  # fmt: skip
    config = library.DepthAnythingConfig(
        backbone_config=backbone, reassemble_hidden_size=16, patch_size=14,
        neck_hidden_sizes=[8, 8], reassemble_factors=[1, 0.5], fusion_hidden_size=8,
        head_hidden_size=4,
    )  # fmt: skip
    library.DepthAnythingForDepthEstimation(config).save_pretrained(tmp_path)
    library.DPTImageProcessor(size={"height": 28, "width": 28}).save_pretrained(tmp_path)
    return tmp_path


def test_a_local_network_says_disparity_of_the_views_size(folder):
    make = depth_anything.prepare(plane_scene(), folder, 0)
    prior = make(1)
    assert prior.disparity.shape == (18, 24)
    assert prior.valid.all()
    assert prior.disparity.std() > 0
    assert torch.equal(prior.disparity, make(1).disparity)


def test_a_folder_that_holds_no_network_is_refused_in_one_line(tmp_path):
    pytest.importorskip("transformers", reason="the extra 'priors' is not installed")
    with pytest.raises(DataError, match="not a folder of a depth network") as error:
        depth_anything.prepare(plane_scene(), tmp_path, 0)
    assert "\n" not in str(error.value)


def test_without_the_library_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(MissingError, match=r"install splatproof\[priors\], or take 'sweep'"):
        depth_anything.prepare(plane_scene(), tmp_path, 0)
