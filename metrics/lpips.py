"""LPIPS where its weights are on disk. Nothing is ever downloaded and nothing stands in for it."""

import functools
import hashlib
import importlib
import re
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatbench.metrics.pairs import check_pair
from splatbench.reference.errors import DataError, MissingError

WEIGHTS = {
    "vgg": "https://download.pytorch.org/models/vgg16-397923af.pth",
    "alex": "https://download.pytorch.org/models/alexnet-owt-7be5be79.pth",
}
"""Where torchvision's ImageNet weights come from; a file's name ends in 8 digits of its sha256.

The linear heads on top of them come with torchmetrics.
"""
SMALLEST = {"vgg": 16, "alex": 31}
"""Shortest side in pixels that still reaches the network's last layer."""


def lpips_vgg_m11(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """LPIPS by VGG-16 on inputs mapped to [-1, 1], as its authors prescribe.

    Args:
        image: What is scored, in [0, 1].
        target: The truth, in [0, 1].
        mask: Must leave every pixel valid: LPIPS has no masked form.
    Returns: >= 0, 0 for equal images; no upper bound.
    Raises: MissingError without torchmetrics, torchvision or weights; DataError on a mask, see
        also metrics.pairs.check_pair.
    Source: Zhang et al. 2018, "The Unreasonable Effectiveness of Deep Features", v0.1 heads.
    """
    return _lpips("lpips_vgg_m11", "vgg", image, target, mask, mapped=True)


def lpips_alex_m11(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """LPIPS by AlexNet on inputs mapped to [-1, 1]; else as `lpips_vgg_m11`."""
    return _lpips("lpips_alex_m11", "alex", image, target, mask, mapped=True)


def lpips_vgg_01(
    image: Float[Tensor, "h w 3"],
    target: Float[Tensor, "_h _w 3"],
    mask: Bool[Tensor, "_h _w"] | None = None,
) -> float:
    """LPIPS by VGG-16 on inputs left in [0, 1], as the 3DGS release calls it (its issue 1239)."""
    return _lpips("lpips_vgg_01", "vgg", image, target, mask, mapped=False)


def weights_file(network: str) -> Path:
    """Where the weights of "vgg" or "alex" are looked for: torch's hub folder (TORCH_HOME)."""
    return Path(torch.hub.get_dir()) / "checkpoints" / WEIGHTS[network].rsplit("/", 1)[1]


def load(network: str) -> str:
    """Load "vgg" or "alex" for all later calls and return the sha256 of its weights.

    Raises: MissingError without torchmetrics, torchvision or weights.
    """
    _network(network)
    return weights_sha256(network)


@functools.cache
def weights_sha256(network: str) -> str:
    """Sha256 of the weights on disk, which must begin as the file's name says.

    Raises: MissingError without the file, DataError where it is another.
    """
    path = weights_file(network)
    if not path.is_file():
        raise MissingError(
            f"LPIPS ({network}) needs weights that are not at {path}; "
            f"download {WEIGHTS[network]} to there"
        )
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    promised = re.findall(r"-([0-9a-f]{8})\.pth$", path.name)[0]
    if not found.startswith(promised):
        raise DataError(
            f"{path}: sha256 is {found[:8]}..., expected {promised}...; "
            f"download {WEIGHTS[network]} again"
        )
    return found


@functools.cache
def _network(network: str) -> Any:
    """The network with its heads, in evaluation mode."""
    try:
        module = importlib.import_module("torchmetrics.image.lpip")
        importlib.import_module("torchvision")
    except (ImportError, RuntimeError) as error:  # RuntimeError: torchvision of another torch
        reason = str(error).splitlines()[0]
        raise MissingError(
            f"LPIPS needs torchmetrics and a torchvision made for torch {torch.__version__} "
            f"({reason}); run: pip install 'splatbench[weights]'"
        ) from error
    weights_sha256(network)  # torchvision would download what is not there
    return module.LearnedPerceptualImagePatchSimilarity(net_type=network).net


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
    first, second = (
        torch.from_numpy(x).float().permute(2, 0, 1)[None] for x in (pair.image, pair.target)
    )
    with torch.no_grad():
        return float(_network(network)(first, second, normalize=mapped))
