"""Random weights of the very networks that learned metrics use, on disk where they are looked for."""

import hashlib
from copy import deepcopy
from functools import cache
from pathlib import Path

import pytest
import torch
from torch import nn

from splatproof.metrics import lpips, weights

MAKE = {"vgg": lpips.vgg16_features, "alex": lpips.alexnet_features}
CACHES = (weights.weights_sha256, lpips._network)


def random_features(network: str) -> nn.Sequential:
    """Layers whose outputs neither grow nor vanish with depth, so that each of them counts."""
    return deepcopy(_drawn(network))


@cache
def _drawn(network: str) -> nn.Sequential:
    """Drawn once: millions of weights take a second."""
    torch.manual_seed(3)
    features = MAKE[network]().requires_grad_(False)
    for layer in features:
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight)
    return features


def forget() -> None:
    """Let go of every network and hash that is remembered."""
    for remembered in CACHES:
        remembered.cache_clear()


def write_weights(folder: Path, network: str, patch: pytest.MonkeyPatch) -> str:
    """Write random weights into a folder, make them the network's, and return their sha256."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "new.pth"
    whole = {f"features.{k}": v for k, v in random_features(network).state_dict().items()}
    torch.save(whole | {"classifier.0.bias": torch.zeros(2)}, path)
    sha = hashlib.sha256(path.read_bytes()).hexdigest()
    path.rename(folder / f"net-{sha[:8]}.pth")
    patch.setitem(weights.WEIGHTS, network, f"https://example.org/net-{sha[:8]}.pth")
    return sha
