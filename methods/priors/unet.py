"""The small convolutional network behind our own priors, and its file of weights."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from splatproof.base.errors import DataError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.reference.types.scene import Scene

LEVELS = 4
"""Levels of each network, every one half as wide and high as the one before."""
STRIDE = 2 ** (LEVELS - 1)
"""Both sides of what a network sees are multiples of this."""
RATE = 1e-3
"""Adam's rate at the start of a training, unless it has its own; it falls to 0 along half a cosine."""
PACKAGED = Path(__file__).parent / "weights"
"""Folder of the weights that come with this package."""
GROUP = 8
"""Groups of channels that are normalised together."""


class UNet(nn.Module):
    """Convolutions down LEVELS levels and up again, each way up joined with what went down.

    Source: Ronneberger et al. 2015, "U-Net"; group normalisation and sizes: ours.
    """

    def __init__(self, inputs: int, outputs: int, widths: tuple[int, ...]) -> None:
        """Start from random weights.

        Args:
            inputs: Channels of the input.
            outputs: Channels of the output.
            widths: Channels of the levels, finest first, LEVELS numbers.
        """
        super().__init__()
        before = (inputs, *widths[:-1])
        self.down = nn.ModuleList(_level(a, b) for a, b in zip(before, widths, strict=True))
        coarse = list(zip(widths[1:], widths[:-1], strict=True))
        self.up = nn.ModuleList(_level(below + here, here) for below, here in coarse)
        self.last = nn.Conv2d(widths[0], outputs, 1)

    def features(self, given: Float[Tensor, "n c h w"]) -> Float[Tensor, "n o h w"]:
        """The output of each pixel; both sides of the input are multiples of STRIDE."""
        kept = []
        at = given
        for index, level in enumerate(self.down):
            at = level(at if index == 0 else functional.max_pool2d(at, 2))
            kept.append(at)
        for index in reversed(range(len(self.up))):
            larger = functional.interpolate(at, scale_factor=2, mode="bilinear")
            at = self.up[index](torch.cat([larger, kept[index]], dim=1))
        return self.last(at)


def _level(before: int, after: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, padding=1), nn.GroupNorm(GROUP, after), nn.ReLU(),
        nn.Conv2d(after, after, 3, padding=1), nn.GroupNorm(GROUP, after), nn.ReLU(),
    )  # fmt: skip


N = TypeVar("N", bound=nn.Module)


def fitted(
    make: Callable[[], N],
    loss: Callable[[N, torch.Generator], Tensor],
    *,
    steps: int,
    seed: int,
    report: Callable[[int, int, float], None],
    rate: float = RATE,
) -> N:
    """A network whose loss Adam followed; equal losses and seed give equal weights on one machine.

    Args:
        make: Makes it with random weights.
        loss: The loss of a batch that it draws with the generator.
        steps: Number of batches.
        seed: Seed of weights and draws.
        report: Told (step, steps, loss).
        rate: Adam's rate at the start.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = make()
    draw = torch.Generator().manual_seed(seed)
    adam = torch.optim.Adam(network.parameters(), lr=rate)
    rates = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps)
    for step in range(steps):
        error = loss(network, draw)
        adam.zero_grad()
        error.backward()
        adam.step()
        rates.step()
        report(step + 1, steps, float(error.detach()))
    return network.eval()


def save_weights(path: Path, network: nn.Module, form: str, facts: dict[str, object]) -> None:
    """Write the weights of a network.

    Args:
        path: A .safetensors file.
        network: What is saved.
        form: What the file is, under "format".
        facts: How it was trained, JSON-ready.
    """
    write_tensors(path, network.state_dict(), {"format": form} | facts)


def load_facts(path: Path) -> dict[str, Any]:
    """How a network was trained, as `save_weights` was told.

    Raises: DataError where the file is missing or damaged.
    """
    _, facts = read_tensors(path, _remedy(path, "bench train-prior"))
    return facts if isinstance(facts, dict) else {}


def domain(scene: Scene, weights: Path) -> str:
    """Whether a network was trained on the kind of world that a scene is, for the record.

    Args:
        scene: What it is asked about; made worlds say their kind in the fact "world".
        weights: File that `save_weights` wrote, with the fact "worlds".
    Returns: "in domain" or "out of domain", with both kinds.
    """
    facts = load_facts(weights)
    kinds = [str(kind) for kind in facts.get("worlds", ())]
    here = scene.facts.get("world", "photos")
    known = "in domain" if here in kinds else "out of domain"
    return f"{known}: trained on {', '.join(kinds) or 'nothing known'}, used on {here}"


def load_weights(path: Path, network: N, form: str, command: str) -> N:
    """Read what `save_weights` wrote into a network of the same sizes.

    Args:
        path: The file.
        network: Takes the weights.
        form: What the file must be.
        command: What writes such files, for the error.
    Raises: DataError where the file is missing, damaged or not such a network's; it says what to do.
    """
    remedy = _remedy(path, command)
    tensors, facts = read_tensors(path, remedy)
    shapes = {name: tensor.shape for name, tensor in network.state_dict().items()}
    same = {name: tensor.shape for name, tensor in tensors.items()} == shapes
    if not same or not isinstance(facts, dict) or facts.get("format") != form:
        raise DataError(f"{path}: not the weights that are expected ({form!r}); {remedy}")
    network.load_state_dict(tensors)
    return network.eval()


def _remedy(path: Path, command: str) -> str:
    """What to do about a file of weights that is missing or damaged."""
    if path.parent == PACKAGED:
        return "it comes with this package: install splatproof again"
    return f"`{command}` writes such files"
