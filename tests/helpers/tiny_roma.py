"""RoMa's tiny network with random weights in a folder, as its authors' file lies there; and a stand-in for the package."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from jaxtyping import Float
from torch import Tensor, nn

from splatproof.methods.priors import roma

NAME = "tiny_roma_v1_outdoor.pth"
SIZE = (320, 384)
"""Height and width of the photo whose places the features tell apart."""


def texture(height: int, width: int) -> Float[Tensor, "1 3 h w"]:
    """Random blobs of 8 pixels."""
    few = torch.rand(1, 3, height // 8, width // 8, generator=torch.Generator().manual_seed(0))
    return nn.functional.interpolate(few, (height, width), mode="bicubic").clamp(0, 1)


def package() -> Any:
    """Package romatch, or a skipped test."""
    try:
        return importlib.import_module("romatch")
    except (
        ImportError,
        RuntimeError,
    ) as error:  # torchvision of another build than torch's: RuntimeError
        pytest.skip(f"romatch is not installed beside the extra 'priors': {error}")


def tiny_folder(folder: Path) -> Path:
    """Weights of the real class whose features tell places of `texture` apart, and which adds nothing to them.

    Random features do not: their products are largest with the longest ones. Those here are made white.
    """
    library = package()
    layer = importlib.import_module("romatch.models.tiny").BasicLayer
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = library.models.model_zoo.roma_models.tiny_roma_v1_model(xfeat=roma._xfeat(layer))
    for part in (network.coarse_matcher, network.fine_matcher):
        nn.init.zeros_(part[-1].weight)
        nn.init.zeros_(part[-1].bias)
    photo, last, kept = texture(*SIZE), network.xfeat[0].block_fusion[-1], []
    with torch.no_grad():
        for part in network.modules():
            if isinstance(part, nn.BatchNorm2d):
                part.momentum = None  # a mean over batches, of which there is one
        network.train()
        network({"im_A": photo, "im_B": photo})
        network.eval()
        hook = last.register_forward_pre_hook(lambda _, given: kept.append(given[0]))
        network({"im_A": photo, "im_B": photo})
        hook.remove()
        seen = kept[0][0].flatten(1).double()
        values, vectors = torch.linalg.eigh(torch.cov(seen))
        white = vectors @ torch.diag((values + 1e-6).rsqrt()) @ vectors.T
        last.weight.copy_(white[:, :, None, None])
        last.bias.copy_(-white @ seen.mean(dim=1))
    torch.save(network.state_dict(), folder / NAME)
    return folder


class Layer(nn.Module):
    """Stands for the package's layer."""

    def __init__(self, before: int, after: int, **more: Any) -> None:
        super().__init__()
        self.layer = nn.Sequential(nn.Conv2d(before, after, bias=False, **more))


class Net(nn.Module):
    """Stands for a network: weights of one name."""

    def __init__(self, given: dict[str, Any]) -> None:
        super().__init__()
        self.one = nn.Parameter(torch.zeros(2))
        self.given = given
        self.load_state_dict(given["weights"])


def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Package romatch with networks of one parameter, in place of any that is installed."""

    def make(device: torch.device, **given: Any) -> Net:
        return Net({"device": device} | given)

    modules = {
        "romatch": SimpleNamespace(tiny_roma_v1_outdoor=make, roma_outdoor=make),
        "romatch.models.tiny": SimpleNamespace(BasicLayer=Layer),
        "loguru": SimpleNamespace(logger=SimpleNamespace(disable=lambda name: None)),
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
