"""Our own refiner of side views: a small network that corrects what warping a photo gives."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional, init

from splatproof.methods.priors.unet import PACKAGED, STRIDE, UNet, load_weights, save_weights
from splatproof.reference.supervision.side_views import SeenView, sees, warp_and_fill

FORMAT = "splatproof view refiner 1"
"""What the facts of a weights file say under "format"."""
WIDTHS = (16, 32, 64, 96)
"""Channels of the levels, finest first."""
INPUTS = 8
"""Channels of the input: the render and what warping made of it (R, G, B each), the render's alpha, and where the
photo sees the surface."""
SHIPPED = PACKAGED / "refiner.safetensors"
"""Weights that come with this package; refiner.json beside them says how they were made."""


class RefinerNetwork(UNet):
    """Four levels with 0.4 million parameters; says what is added to the warped view, at first nothing."""

    def __init__(self) -> None:
        """Start from random weights, with the last of zeros."""
        super().__init__(INPUTS, 3, WIDTHS)
        init.zeros_(self.last.weight)
        assert self.last.bias is not None
        init.zeros_(self.last.bias)

    def forward(self, given: Float[Tensor, "n 8 h w"]) -> Float[Tensor, "n 3 h w"]:
        """The refined view, not clamped; both sides of the input are multiples of STRIDE."""
        return (given[:, WARPED] + 1) / 2 + self.features(given)


WARPED = slice(3, 6)
"""Channels of the warped view among the inputs."""


def refiner_input(side: SeenView, photo: SeenView) -> Float[Tensor, "8 h w"]:
    """A flawed side view and the photo that guides it as the network takes them: numbers from -1 to 1.

    Args:
        side: The render of the side view.
        photo: The training view, with its photo.
    """
    pictures = torch.cat([side.image.clamp(0, 1), warp_and_fill(side, photo).clamp(0, 1)], dim=2)
    masks = torch.stack([side.alpha.float(), sees(photo, side).float()])
    return 2 * torch.cat([pictures.float().permute(2, 0, 1), masks]) - 1


class OwnRefiner:
    """A ViewRefiner: the network on whole views, of any size."""

    def __init__(self, network: RefinerNetwork) -> None:
        """Take a trained network."""
        self.network = network

    @torch.inference_mode()
    def __call__(self, side: SeenView, photo: SeenView) -> Float[Tensor, "h w 3"]:
        """The refined image of the side view, in [0, 1].

        Args:
            side: The flawed side view.
            photo: The training view that guides it, with its photo.

        Source: DPGS, Eq. 3, with a network of ours in place of its diffusion model.
        """
        given = refiner_input(side, photo)
        height, width = given.shape[1:]
        missing = (0, -width % STRIDE, 0, -height % STRIDE)
        whole = functional.pad(given[None], missing, mode="replicate")
        said = self.network(whole)[0, :, :height, :width]
        return said.permute(1, 2, 0).clamp(0, 1).clone()


def save_refiner(path: Path, network: RefinerNetwork, facts: dict[str, object]) -> None:
    """Write the weights.

    Args:
        path: A .safetensors file.
        network: What is saved.
        facts: How it was trained, JSON-ready.
    """
    save_weights(path, network, FORMAT, facts)


def load_refiner(path: Path = SHIPPED) -> RefinerNetwork:
    """Read what `save_refiner` wrote.

    Args:
        path: File of the weights.
    Raises: DataError where the file is missing, damaged or not such a network's.
    """
    return load_weights(path, RefinerNetwork(), FORMAT, "bench train-prior refiner")
