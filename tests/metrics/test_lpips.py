"""LPIPS: what is said when it cannot be had, and what reaches the network when it can."""

import hashlib
import importlib

import pytest
import torch

from helpers.images import noise_image, spoiled
from splatbench.metrics import lpips
from splatbench.metrics.registry import METRICS, load_weights
from splatbench.reference.errors import DataError, MissingError

NETWORKS = {"lpips_vgg_m11": "vgg", "lpips_alex_m11": "alex", "lpips_vgg_01": "vgg"}
NAMES = pytest.mark.parametrize("name", NETWORKS)
IMAGE = noise_image(64, 70, 0)
CACHES = (lpips.weights_sha256, lpips._network)


@pytest.fixture(autouse=True)
def empty_hub(tmp_path, monkeypatch):
    """A hub folder without weights, and nothing remembered from other tests."""
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    for cache in CACHES:
        cache.cache_clear()
    yield tmp_path / "checkpoints"
    for cache in CACHES:
        cache.cache_clear()


def unavailable(error):
    def import_module(name):
        raise error

    return import_module


@NAMES
@pytest.mark.parametrize(
    "error",
    [
        ModuleNotFoundError("No module named 'torchmetrics'"),
        RuntimeError("operator torchvision::nms does not exist"),
    ],
)
def test_without_its_packages_it_says_what_to_install(name, error, monkeypatch):
    monkeypatch.setattr(importlib, "import_module", unavailable(error))
    message = rf"{error}.*pip install 'splatbench\[weights\]'"
    with pytest.raises(MissingError, match=message) as caught:
        METRICS[name].function(IMAGE, IMAGE, None)
    assert "\n" not in str(caught.value)


@NAMES
def test_without_weights_it_says_where_they_belong(name, monkeypatch, empty_hub):
    monkeypatch.setattr(importlib, "import_module", lambda name: None)
    url = lpips.WEIGHTS[NETWORKS[name]]
    with pytest.raises(MissingError, match=f"not at {empty_hub}/.*download {url}"):
        METRICS[name].function(IMAGE, IMAGE, None)
    with pytest.raises(MissingError, match="not at"):
        load_weights(["psnr", name])


@pytest.mark.parametrize("network", lpips.WEIGHTS)
def test_other_weights_under_the_name_are_refused(network, empty_hub):
    empty_hub.mkdir()
    lpips.weights_file(network).write_bytes(b"other weights")
    found = hashlib.sha256(b"other weights").hexdigest()
    with pytest.raises(DataError, match=f"sha256 is {found[:8]}"):
        lpips.weights_sha256(network)


def test_the_right_weights_are_loaded_and_hashed_for_the_record(monkeypatch, empty_hub):
    class Module:
        @staticmethod
        def LearnedPerceptualImagePatchSimilarity(net_type):
            return Module

        net = "the network"

    monkeypatch.setattr(importlib, "import_module", lambda name: Module)
    found = hashlib.sha256(b"weights").hexdigest()
    monkeypatch.setitem(lpips.WEIGHTS, "vgg", f"https://example.org/vgg16-{found[:8]}.pth")
    empty_hub.mkdir()
    (empty_hub / f"vgg16-{found[:8]}.pth").write_bytes(b"weights")
    assert load_weights(["psnr", "lpips_vgg_m11"]) == {"lpips_vgg_m11": found}
    assert lpips._network("vgg") == "the network"


@pytest.mark.parametrize(("name", "mapped"), [*zip(NETWORKS, (True, True, False), strict=True)])
def test_what_reaches_the_network(name, mapped, monkeypatch):
    seen = []

    def network(first, second, normalize):
        seen.append((first, second, normalize))
        return torch.tensor([[[[0.25]]]])

    monkeypatch.setattr(lpips, "_network", lambda kind: seen.append(kind) or network)
    target = spoiled(IMAGE, 0.1)
    assert METRICS[name].function(IMAGE, target, torch.ones(64, 70, dtype=torch.bool)) == 0.25
    kind, (first, second, normalize) = seen
    assert kind == NETWORKS[name]
    assert torch.equal(first[0].permute(1, 2, 0), IMAGE)
    assert torch.equal(second[0].permute(1, 2, 0), target)
    assert normalize is mapped  # torchmetrics maps [0, 1] to [-1, 1] if told to


@NAMES
def test_masks_and_small_images_are_refused(name):
    mask = torch.ones(64, 70, dtype=torch.bool)
    mask[0, 0] = False
    with pytest.raises(DataError, match=f"{name}: has no masked form"):
        METRICS[name].function(IMAGE, IMAGE, mask)
    side = lpips.SMALLEST[NETWORKS[name]]
    with pytest.raises(DataError, match=f"{side} x {side} px window"):
        METRICS[name].function(IMAGE[: side - 1], IMAGE[: side - 1], None)


@pytest.mark.parametrize("network", lpips.WEIGHTS)
def test_a_network_of_the_same_class_with_random_weights(network, monkeypatch, empty_hub):
    """Needs torchvision, which exists for few builds of torch."""
    try:
        models = importlib.import_module("torchvision").models
        functional = importlib.import_module("torchmetrics.functional.image")
    except (ImportError, RuntimeError) as error:
        pytest.skip(f"torchvision or torchmetrics: {str(error).splitlines()[0]}")
    empty_hub.mkdir()
    make = {"vgg": models.vgg16, "alex": models.alexnet}[network]
    torch.manual_seed(0)
    torch.save(make(weights=None).state_dict(), lpips.weights_file(network))
    monkeypatch.setattr(lpips, "weights_sha256", lambda network: "")
    target = spoiled(IMAGE, 0.1)
    first, second = (x.permute(2, 0, 1)[None] for x in (IMAGE, target))
    want = functional.learned_perceptual_image_patch_similarity(
        first, second, net_type=network, normalize=True
    )
    name = f"lpips_{network}_m11"
    assert METRICS[name].function(IMAGE, target, None) == pytest.approx(float(want), rel=1e-5)
    assert METRICS[name].function(IMAGE, IMAGE, None) == 0
    side = lpips.SMALLEST[network]
    assert METRICS[name].function(IMAGE[:side, :side], target[:side, :side], None) > 0
