"""LPIPS: what is said when it cannot be had, and what it is when it can.

Weights are random, of the very networks; the heads are the true ones.
"""

import hashlib
import importlib
import importlib.util

import pytest
import torch

from helpers.images import noise_image, spoiled
from helpers.random_weights import forget, random_features, write_weights
from splatproof.base.errors import DataError, MissingError
from splatproof.metrics import lpips, weights
from splatproof.metrics.registry import BUILT_IN, load_weights

NETWORKS = {"lpips_vgg_m11": "vgg", "lpips_alex_m11": "alex", "lpips_vgg_01": "vgg"}
NAMES = pytest.mark.parametrize("name", NETWORKS)
SLOW = pytest.mark.slow
KINDS = pytest.mark.parametrize("network", weights.WEIGHTS)
TORCHVISION = {"vgg": "vgg16", "alex": "alexnet"}
IMAGE = noise_image(64, 70, 0)


@pytest.fixture(autouse=True)
def empty(tmp_path, monkeypatch):
    """Folders without weights, and nothing remembered from other tests."""
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.delenv(weights.VARIABLE, raising=False)
    forget()
    yield
    forget()


@pytest.fixture(params=["variable", "hub"])
def stored(request, tmp_path, monkeypatch):
    """Writes random weights of a network where they are looked for; returns their sha256."""
    folder = tmp_path / "hub" / "checkpoints"
    if request.param == "variable":
        folder = tmp_path / "mine"
        monkeypatch.setenv(weights.VARIABLE, str(folder))
    return lambda network: write_weights(folder, network, monkeypatch)


@NAMES
def test_without_torchmetrics_it_says_what_to_install(name, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingError, match=r"pip install 'splatproof\[weights\]'") as caught:
        BUILT_IN[name].function(IMAGE, IMAGE, None)
    assert "\n" not in str(caught.value)


@NAMES
def test_without_weights_it_says_where_they_belong(name, tmp_path, monkeypatch):
    url = weights.WEIGHTS[NETWORKS[name]]
    hub = tmp_path / "hub" / "checkpoints"
    with pytest.raises(MissingError, match=f"not in {hub}; download {url} to there, or set SPLAT"):
        BUILT_IN[name].function(IMAGE, IMAGE, None)
    monkeypatch.setenv(weights.VARIABLE, str(tmp_path / "mine"))
    with pytest.raises(MissingError, match=f"not in {tmp_path / 'mine'} or {hub}; download"):
        load_weights(["psnr", name])


@KINDS
def test_other_weights_under_the_name_are_refused(network, tmp_path):
    path = tmp_path / "hub" / "checkpoints" / weights.WEIGHTS[network].rsplit("/", 1)[1]
    path.parent.mkdir(parents=True)
    path.write_bytes(b"other weights")
    found = hashlib.sha256(b"other weights").hexdigest()
    with pytest.raises(DataError, match=f"sha256 is {found[:8]}"):
        lpips.load(network)


@pytest.mark.parametrize("content", [b"not a model", b""])
def test_a_file_that_holds_no_such_network_is_named(content, tmp_path, monkeypatch):
    sha = hashlib.sha256(content).hexdigest()[:8]
    (tmp_path / f"net-{sha}.pth").write_bytes(content)
    monkeypatch.setenv(weights.VARIABLE, str(tmp_path))
    monkeypatch.setitem(weights.WEIGHTS, "alex", f"https://example.org/net-{sha}.pth")
    with pytest.raises(DataError, match=rf"net-{sha}\.pth: no weights of alex") as caught:
        lpips.load("alex")
    assert "\n" not in str(caught.value)


@KINDS
def test_weights_on_disk_are_used_and_hashed_for_the_record(network, stored):
    sha = stored(network)
    name = f"lpips_{network}_m11"
    assert load_weights(["psnr", name]) == {name: sha}
    target = spoiled(IMAGE, 0.1)
    _, heads = lpips._network(network)
    first, second = (2 * x.permute(2, 0, 1)[None] - 1 for x in (IMAGE, target))
    want = lpips.distance(first, second, random_features(network), lpips.TAPS[network], heads)
    assert BUILT_IN[name].function(IMAGE, target, None) == pytest.approx(float(want), rel=1e-6)
    assert BUILT_IN[name].function(IMAGE, IMAGE, None) == 0
    side = lpips.SMALLEST[network]
    assert BUILT_IN[name].function(IMAGE[:side, :side], target[:side, :side], None) > 0


@pytest.mark.parametrize("stored", ["variable", pytest.param("hub", marks=SLOW)], indirect=True)
def test_the_release_leaves_its_inputs_in_0_1(stored):
    stored("vgg")
    target = spoiled(IMAGE, 0.1)
    mapped, left = (
        BUILT_IN[name].function(IMAGE, target, None) for name in ("lpips_vgg_m11", "lpips_vgg_01")
    )
    half = (BUILT_IN["lpips_vgg_m11"].function((x + 1) / 2, (y + 1) / 2, None)
            for x, y in [(IMAGE, target)])  # fmt: skip
    assert next(half) == pytest.approx(left, rel=1e-5)
    assert mapped != pytest.approx(left, rel=0.01)


@pytest.mark.parametrize(
    ("network", "height", "width", "seed"),
    [
        # the formula is one, and VGG takes ten times as long
        pytest.param(network, *size, marks=SLOW if network == "vgg" and size[0] > 31 else ())
        for network in weights.WEIGHTS
        for size in [(31, 31, 0), (64, 33, 1), (47, 80, 2)]
    ],
)
def test_the_formula_is_that_of_torchmetrics(network, height, width, seed):
    """Its class with our layers in the place of torchvision's, which few builds of torch have."""
    module = importlib.import_module("torchmetrics.functional.image.lpips")
    generator = torch.Generator().manual_seed(seed)
    first, second = (2 * torch.rand(2, 1, 3, height, width, generator=generator) - 1).unbind()
    features = random_features(network)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_get_tv_model_features", lambda net, pretrained: features)
        other = module._NoTrainLpips(net=network)
    heads = [lin.model[1].weight.flatten() for lin in other.lins]
    found = lpips.distance(first, second, features, lpips.TAPS[network], heads)
    assert float(found) == pytest.approx(float(other(first, second)), rel=1e-4)
    for lost in range(5):
        left = [i for i in range(5) if i != lost]
        taps = tuple(lpips.TAPS[network][i] for i in left)
        fewer = lpips.distance(first, second, features, taps, [heads[i] for i in left])
        assert float(fewer) < 0.99 * float(found)


@KINDS
def test_the_layers_are_those_of_torchvision(network):
    try:
        models = importlib.import_module("torchvision.models")
    except (ImportError, RuntimeError) as error:  # RuntimeError: torchvision of another torch
        pytest.skip(f"torchvision: {str(error).splitlines()[0]}")
    theirs = getattr(models, TORCHVISION[network])(weights=None).features
    ours = random_features(network)
    theirs.load_state_dict(ours.state_dict())
    picture = torch.rand(1, 3, 64, 64)
    assert torch.equal(ours(picture), theirs(picture))


@KINDS
def test_the_network_has_the_published_number_of_weights(network):
    """Convolutions of VGG-16 (Simonyan & Zisserman) and of AlexNet in one tower, with biases."""
    count = sum(values.numel() for values in random_features(network).state_dict().values())
    assert count == {"vgg": 14_714_688, "alex": 2_469_696}[network]


@NAMES
def test_masks_and_small_images_are_refused(name):
    mask = torch.ones(64, 70, dtype=torch.bool)
    mask[0, 0] = False
    with pytest.raises(DataError, match=f"{name}: has no masked form"):
        BUILT_IN[name].function(IMAGE, IMAGE, mask)
    side = lpips.SMALLEST[NETWORKS[name]]
    with pytest.raises(DataError, match=f"{side} x {side} px window"):
        BUILT_IN[name].function(IMAGE[: side - 1], IMAGE[: side - 1], None)
