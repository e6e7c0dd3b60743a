"""The offline depth denoiser of one photo, its sweeps in the kernel."""

from jaxtyping import Float
from torch import Tensor

from splatproof.methods.kernels import diffusion
from splatproof.reference.layered_memory.edge_diffusion import EdgeDiffusion, exchange_weights


class PhotoDiffusion(EdgeDiffusion):
    """EdgeDiffusion of one photo in float32: the weights between its pixels are made once.

    Source: as of `EdgeDiffusion`, which it is held against.
    """

    def __init__(
        self, image: Float[Tensor, "h w 3"], prior: Float[Tensor, "h w"] | None = None
    ) -> None:
        """Keep the photo's weights.

        Args:
            image: The photo, sRGB in [0, 1], float32: all other methods are given the same.
            prior: Depth in (0, 1) of the photo; None: 0.5 everywhere.

        Raises: As EdgeDiffusion, and as the kernel.
        """
        super().__init__(prior=prior)
        self.weights = exchange_weights(image, self.contrast)

    def smooth(
        self, values: Float[Tensor, "h w"], image: Float[Tensor, "h w 3"]
    ) -> Float[Tensor, "h w"]:
        """Sweeps of exchange between the photo's edges.

        Args:
            values: What is smoothed.
            image: The photo; its weights are kept.
        """
        del image
        return diffusion.diffused(values, *self.weights, self.sweeps)
