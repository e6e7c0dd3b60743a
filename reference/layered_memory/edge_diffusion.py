"""The offline depth denoiser: diffusion that stops at the image's edges. It has learnt nothing."""

import torch
from jaxtyping import Float
from torch import Tensor


class EdgeDiffusion:
    """Pixel-space denoiser: the latent is a depth logit; each step smooths it between edges.

    It knows no depth by itself: what it adds to the guidance is that depth changes where the
    image changes. The floor that learned denoisers must beat. No state but its constants.

    Source: ours; weights after Perona and Malik 1990, "Scale-space and edge detection", Eq. 9.
    """

    def __init__(self, steps: int = 3, sweeps: int = 60, contrast: float = 0.1) -> None:
        """Choose how far values travel.

        Args:
            steps: Number of denoising steps.
            sweeps: Number of smoothing sweeps a step; values travel about sqrt(sweeps) pixels.
            contrast: Colour difference (of 1) at which the exchange falls to 1/e.

        Raises: ValueError if one of them is not positive.
        """
        if steps < 1 or sweeps < 1 or not contrast > 0:
            raise ValueError(
                f"need positive steps, sweeps, contrast: {steps}, {sweeps}, {contrast}"
            )
        self.steps, self.sweeps, self.contrast = steps, sweeps, contrast

    def encode(
        self, image: Float[Tensor, "h w 3"], generator: torch.Generator
    ) -> Float[Tensor, "h w"]:
        """A little noise around depth 0.5.

        Args:
            image: The view's photo; its size and dtype are those of the latent.
            generator: Source of the noise.
        """
        height, width, _ = image.shape
        return 0.1 * torch.randn(height, width, generator=generator).to(image)

    def denoise(
        self, latent: Float[Tensor, "h w"], image: Float[Tensor, "h w 3"], step: int
    ) -> Float[Tensor, "h w"]:
        """Sweeps of exchange with the four neighbours, weighted exp(-(|dI| / contrast)^2).

        Args:
            latent: Depth logits before this step.
            image: The view's photo, sRGB in [0, 1]; values stop where it changes.
            step: Number of the step; not used, since every step is alike.
        """
        del step  # every step is alike
        across = self._weights(image[:, 1:] - image[:, :-1])
        down = self._weights(image[1:] - image[:-1])
        for _ in range(self.sweeps):
            flow_x = across * (latent[:, 1:] - latent[:, :-1])
            flow_y = down * (latent[1:] - latent[:-1])
            change = torch.zeros_like(latent)
            change[:, :-1] += flow_x
            change[:, 1:] -= flow_x
            change[:-1] += flow_y
            change[1:] -= flow_y
            latent = latent + 0.25 * change  # 1/4: stable for four neighbours of weight <= 1
        return latent

    def decode(self, latent: Float[Tensor, "h w"]) -> Float[Tensor, "h w"]:
        """Depth in (0, 1): the sigmoid of the latent."""
        return torch.sigmoid(latent)

    def _weights(self, difference: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w"]:
        return torch.exp(-difference.square().sum(dim=-1) / self.contrast**2)
