"""LPIPS where its weights are on disk. Nothing stands in for it."""

import functools
import importlib.util
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from splatproof.base.errors import DataError, MissingError
from splatproof.metrics.pairs import check_pair
from splatproof.metrics.weights import find_weights, weights_sha256

SMALLEST = {"vgg": 16, "alex": 31}
"""Shortest side in pixels that still reaches the network's last layer."""
TAPS = {"vgg": (3, 8, 15, 22, 29), "alex": (1, 4, 7, 9, 11)}
"""Layers of the network that are compared: the last ReLU before each pooling; all five of AlexNet."""
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""The release's normalisation of images in [-1, 1]."""
EPSILON = 1e-8
"""Added inside the square root of a feature's length, as in torchmetrics; the release adds 1e-10
outside."""


def lpips_vgg_m11(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """LPIPS by VGG-16 on inputs mapped to [-1, 1], as its authors prescribe.

    Args:
        image: What is scored, in [0, 1], both sides at least 16.
        target: The truth, in [0, 1].
        mask: Must leave every pixel valid, or be None: LPIPS has no masked form.
    Returns: >= 0, 0 for equal images; no upper bound.
    Raises: MissingError without torchmetrics (its heads) or weights; DataError on a mask, see also
        metrics.pairs.check_pair.
    Source: Zhang et al. 2018, "The Unreasonable Effectiveness of Deep Features", Eq. 1, v0.1 heads.
    """
    return _lpips("lpips_vgg_m11", "vgg", image, target, mask, mapped=True)


def lpips_alex_m11(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """LPIPS by AlexNet on inputs mapped to [-1, 1]; else as `lpips_vgg_m11`.

    Args:
        image: What is scored, in [0, 1], both sides at least 31.
        target: The truth, in [0, 1].
        mask: Must leave every pixel valid, or be None: LPIPS has no masked form.
    Returns: >= 0, 0 for equal images; no upper bound.
    Raises: As lpips_vgg_m11.
    """
    return _lpips("lpips_alex_m11", "alex", image, target, mask, mapped=True)


def lpips_vgg_01(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """LPIPS by VGG-16 on inputs left in [0, 1], as the 3DGS release calls it (its issue 1239).

    Args:
        image: What is scored, in [0, 1], both sides at least 16.
        target: The truth, in [0, 1].
        mask: Must leave every pixel valid, or be None: LPIPS has no masked form.
    Returns: >= 0, 0 for equal images; no upper bound.
    Raises: As lpips_vgg_m11.
    """
    return _lpips("lpips_vgg_01", "vgg", image, target, mask, mapped=False)


def load(network: str) -> str:
    """Load "vgg" or "alex" for all later calls and return the sha256 of its weights.

    Raises: MissingError without torchmetrics or weights, DataError where they are others.
    """
    _network(network)
    return weights_sha256(find_weights(network))


def distance(
    first: Float[Tensor, "1 3 h w"],
    second: Float[Tensor, "1 3 h w"],
    features: nn.Sequential,
    taps: tuple[int, ...],
    heads: list[Float[Tensor, " _c"]],
) -> Float[Tensor, ""]:
    """d = sum_l mean_hw sum_c w_lc (y_lc - y'_lc)^2, y_l the features of layer l at unit length.

    Args:
        first: One image, in [-1, 1].
        second: The other image, in [-1, 1].
        features: Layers of the network, with their weights.
        taps: Indices of the layers whose output is compared, ascending.
        heads: Weights w_l >= 0 of each compared layer's channels.
    """
    total = first.new_zeros(())
    pair = torch.cat([first, second])
    shape = (1, 3, 1, 1)
    flow = (pair - pair.new_tensor(SHIFT).view(shape)) / pair.new_tensor(SCALE).view(shape)
    for index, layer in enumerate(list(features)[: taps[-1] + 1]):
        flow = layer(flow)
        if index in taps:
            unit = flow / (EPSILON + flow.square().sum(dim=1, keepdim=True)).sqrt()
            weight = heads[taps.index(index)]
            total = total + torch.einsum("c,chw->hw", weight, (unit[0] - unit[1]).square()).mean()
    return total


def vgg16_features() -> nn.Sequential:
    """The convolutions of VGG-16, numbered as in the file of its weights.

    Source: Simonyan & Zisserman 2015, "Very Deep Convolutional Networks", Table 1, column D.
    """
    layers: list[nn.Module] = []
    channels = 3
    for width, count in ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3)):
        for _ in range(count):
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU()]
            channels = width
        layers.append(nn.MaxPool2d(2))
    return nn.Sequential(*layers)


def alexnet_features() -> nn.Sequential:
    """The convolutions of AlexNet, numbered as in the file of its weights.

    Source: Krizhevsky 2014, "One weird trick for parallelizing convolutional neural networks".
    """
    return nn.Sequential(
        nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2),
        nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2),
        nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(),
        nn.Conv2d(384, 256, 3, padding=1), nn.ReLU(),
        nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(), nn.MaxPool2d(3, 2),
    )  # fmt: skip


@functools.cache
def _network(network: str) -> tuple[nn.Sequential, list[Tensor]]:
    """Layers with their weights, and the heads."""
    heads = torch.load(_heads_file(network), map_location="cpu", weights_only=True)
    path = find_weights(network)
    weights_sha256(path)
    features = {"vgg": vgg16_features, "alex": alexnet_features}[network]()
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
        own = {k.removeprefix("features."): v for k, v in stored.items() if k[:9] == "features."}
        features.load_state_dict(own)
    except Exception as error:
        said = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise DataError(f"{path}: no weights of {network}: {said}; download it again") from error
    features.requires_grad_(False)
    return features, [heads[f"lin{i}.model.1.weight"].flatten() for i in range(len(TAPS[network]))]


def _heads_file(network: str) -> Path:
    """The linear heads, which come with torchmetrics; it is not imported."""
    found = importlib.util.find_spec("torchmetrics")
    if found is None or not found.submodule_search_locations:
        raise MissingError(
            "LPIPS takes its linear heads from torchmetrics, which is not installed; "
            "run: pip install 'splatproof[weights]'"
        )
    return Path(found.submodule_search_locations[0], f"functional/image/lpips_models/{network}.pth")


def _lpips(
    name: str,
    network: str,
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None,
    *,
    mapped: bool,
) -> float:
    pair = check_pair(image, target, mask, window=SMALLEST[network], metric=name)
    if not pair.valid.all():
        raise DataError(
            f"{name}: has no masked form; score it under a protocol with masked = false"
        )
    features, heads = _network(network)
    first, second = (
        torch.from_numpy(x).float().permute(2, 0, 1)[None] for x in (pair.image, pair.target)
    )
    if mapped:
        first, second = 2 * first - 1, 2 * second - 1
    with torch.no_grad():
        return float(distance(first, second, features, TAPS[network], heads))
