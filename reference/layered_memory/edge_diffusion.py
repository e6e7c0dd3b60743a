"""The offline depth denoiser: diffusion that stops at the image's edges. It has learnt nothing."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad


class EdgeDiffusion:
    """Pixel-space denoiser: the latent is a depth logit; each step smooths it between edges.

    It knows no depth by itself: what it adds to the guidance is that depth changes where the
    image changes. With a prior depth of the photo the latent is what is to be added to that one's
    logit, and guidance mends it smoothly. The floor that learned denoisers must beat.

    Source: ours; weights after Perona and Malik 1990, "Scale-space and edge detection", Eq. 9.
    """

    def __init__(
        self,
        steps: int = 3,
        sweeps: int = 60,
        contrast: float = 0.1,
        prior: Float[Tensor, "h w"] | None = None,
    ) -> None:
        """Choose how far values travel, and from where.

        Args:
            steps: Number of denoising steps.
            sweeps: Number of smoothing sweeps a step; values travel about sqrt(sweeps) pixels.
            contrast: Colour difference (of 1) at which the exchange falls to 1/e.
            prior: Depth in (0, 1) of the one photo that is to be adapted; None: 0.5 everywhere.

        Raises: ValueError if one of them is not positive, or the prior not between 0 and 1.
        """
        if prior is not None and not bool(((prior > 0) & (prior < 1)).all()):
            raise ValueError("need a prior depth between 0 and 1 at every pixel")
        if steps < 1 or sweeps < 1 or not contrast > 0:
            raise ValueError(
                f"need positive steps, sweeps, contrast: {steps}, {sweeps}, {contrast}"
            )
        self.steps, self.sweeps, self.contrast = steps, sweeps, contrast
        self.prior = None if prior is None else torch.logit(prior)

    def start(
        self, image: Float[Tensor, "h w 3"], generator: torch.Generator
    ) -> Float[Tensor, "h w"]:
        """A little noise around depth 0.5.

        Args:
            image: The view's photo; its size and dtype are those of the latent.
            generator: Source of the noise.
        """
        height, width, _ = image.shape
        return 0.1 * torch.randn(height, width, generator=generator).to(image)

    def predict_clean(
        self, latent: Float[Tensor, "h w"], image: Float[Tensor, "h w 3"], step: int
    ) -> Float[Tensor, "h w"]:
        """What is left of the latent between the image's edges.

        Args:
            latent: Depth logits before this step.
            image: The view's photo, sRGB in [0, 1]; values stop where it changes.
            step: Number of the step; not used, since noise is smoothed alike in each.
        """
        del step
        return self.smooth(latent, image)

    def advance(
        self, latent: Float[Tensor, "h w"], clean: Float[Tensor, "h w"], step: int
    ) -> Float[Tensor, "h w"]:
        """x_(t-1) = x_0 + (sigma_(t-1) / sigma_t) (x_t - x_0), sigma falling evenly to 0.

        Args:
            latent: Latent x_t before this step.
            clean: Guided estimate x_0 of the clean latent.
            step: Number of the step, from 0 to steps - 1; the last one returns `clean`.

        Source: the deterministic step of Song et al. 2021, "Denoising Diffusion Implicit Models",
            Eq. 13 (noise added to x_0, not mixed with it).
        """
        noise_left = (self.steps - step - 1) / (self.steps - step)
        return clean + noise_left * (latent - clean)

    def decode(
        self, latent: Float[Tensor, "h w"], image: Float[Tensor, "h w 3"]
    ) -> Float[Tensor, "h w"]:
        """Depth in (0, 1): sigmoid of the prior's logit plus the latent, spread between the image's edges.

        The spreading takes guidance at single pixels to their surroundings, as the receptive field
        of a learned decoder does.

        Args:
            latent: Clean depth logits.
            image: The view's photo, sRGB in [0, 1]; values stop where it changes.
        """
        added = self.smooth(latent, image)
        return torch.sigmoid(added if self.prior is None else added + self.prior.to(added))

    def smooth(
        self, values: Float[Tensor, "h w"], image: Float[Tensor, "h w 3"]
    ) -> Float[Tensor, "h w"]:
        """`sweeps` sweeps of exchange between the image's edges.

        Args:
            values: What is smoothed.
            image: The view's photo, sRGB in [0, 1]; values stop where it changes.
        """
        return diffused(values, *exchange_weights(image, self.contrast), self.sweeps)


def exchange_weights(
    image: Float[Tensor, "h w 3"], contrast: float
) -> tuple[Float[Tensor, "h w-1"], Float[Tensor, "h-1 w"]]:
    """How much neighbouring pixels exchange, 0 to 1: exp(-(|dI| / contrast)^2).

    Args:
        image: The photo, sRGB in [0, 1].
        contrast: Colour difference (of 1) at which the exchange falls to 1/e.

    Returns: Weight of each pixel and the one to its right, and of each pixel and the one below.

    Source: Perona and Malik 1990, Eq. 9.
    """

    def weights(difference: Tensor) -> Tensor:
        return torch.exp(-difference.square().sum(dim=-1) / contrast**2)

    return weights(image[:, 1:] - image[:, :-1]), weights(image[1:] - image[:-1])


def diffused(
    values: Float[Tensor, "h w"],
    across: Float[Tensor, "h w-1"],
    down: Float[Tensor, "h-1 w"],
    sweeps: int,
) -> Float[Tensor, "h w"]:
    """Sweeps of exchange with the four neighbours. Linear, and a symmetric map: it is its own gradient's.

    Args:
        values: What is smoothed.
        across: Weight, 0 to 1, of the exchange with the pixel to the right.
        down: Weight, 0 to 1, of the exchange with the pixel below.
        sweeps: Number of sweeps; values travel about its root in pixels.
    """
    for _ in range(sweeps):
        # nothing flows over the rim; writing into parts of one tensor would have the gradient copy it each time
        flow_x = pad(across * (values[:, 1:] - values[:, :-1]), (1, 1))
        flow_y = pad(down * (values[1:] - values[:-1]), (0, 0, 1, 1))
        change = flow_x[:, 1:] - flow_x[:, :-1] + flow_y[1:] - flow_y[:-1]
        values = values + 0.25 * change  # 1/4: stable for four neighbours of weight <= 1
    return values
