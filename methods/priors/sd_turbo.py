"""Refiner `sd-turbo`: Stable Diffusion Turbo on side views, with a photo in its attention, from a local folder."""

from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from splatproof.methods.priors.diffusers_folder import pipeline
from splatproof.reference.supervision.side_views import SeenView

SIDE = 512
"""Least pixels of the shorter side of what the network sees: it was trained at this size."""
STRIDE = 64
"""Both sides of what it sees are multiples of this."""
STEPS = 2
STRENGTH = 0.5
"""The second of two steps: half of the noise, and one evaluation of the network. Ours; the paper says neither."""
PROMPT = "an aerial photo"


class SdTurboRefiner:
    """A ViewRefiner: the render, half drowned in noise, drawn again by the network in one step."""

    def __init__(self, folder: Path, *, reference: bool) -> None:
        """Read the weights.

        Args:
            folder: Folder of a StableDiffusionImg2ImgPipeline, see `pipeline`.
            reference: Whether the photo guides the network.
        Raises: MissingError without the library; DataError where the folder is not such a model's.
        """
        self._draw = pipeline(
            folder, "StableDiffusionImg2ImgPipeline", "side.refiner 'sd-turbo'", "'warp'"
        )
        self._reference = reference
        if reference:
            unet = self._draw.unet
            unet.set_attn_processor({
                name: JoinedAttention(plain) if "attn1" in name else plain
                for name, plain in unet.attn_processors.items()
            })  # fmt: skip

    @torch.inference_mode()
    def __call__(self, side: SeenView, photo: SeenView) -> Float[Tensor, "h w 3"]:
        """The refined image of the side view, in [0, 1]; the same views give the same image.

        Args:
            side: The flawed side view.
            photo: The training view that guides it, with its photo; it is stretched to the side view's size.

        Source: DPGS, Sec. 3.2 and Eq. 3.
        """
        height, width = side.image.shape[:2]
        given = _sized(side.image, (height, width))
        if self._reference:
            given = torch.cat([given, _sized(photo.image, (height, width))])
        drawn = self._draw(
            prompt=[PROMPT] * len(given), image=given, strength=STRENGTH, num_inference_steps=STEPS,
            guidance_scale=0.0, generator=torch.Generator().manual_seed(0), output_type="pt",
        ).images[:1]  # fmt: skip
        zoom = _zoom(height, width)
        whole = drawn[..., : round(zoom * height), : round(zoom * width)].float()
        small = functional.interpolate(
            whole, (height, width), mode="bicubic", antialias=True, align_corners=False
        )
        return small[0].permute(1, 2, 0).clamp(0, 1).clone()


class JoinedAttention:
    """Self-attention of two images in which the first sees the tokens of both, the second its own.

    Source: DPGS, Sec. 3.2: keys and values of the reference are joined to the target's.
    """

    def __init__(self, plain: Any) -> None:
        """Take what computes attention otherwise."""
        self._plain = plain

    def __call__(
        self, attn: Any, hidden_states: Float[Tensor, "2 n c"], *rest: Any, **more: Any
    ) -> Float[Tensor, "2 n c"]:
        """Attention as the library asks for it.

        Args:
            attn: The layer.
            hidden_states: Tokens of the side view, then of the photo.
            rest: As the library passes it on.
            more: The same.
        """
        first, second = hidden_states.split(1)
        both = hidden_states.reshape(1, -1, hidden_states.shape[-1])
        return torch.cat([self._plain(attn, first, both), self._plain(attn, second, *rest, **more)])


def _zoom(height: int, width: int) -> float:
    return max(1.0, SIDE / min(height, width))


def _sized(image: Float[Tensor, "a b 3"], size: tuple[int, int]) -> Float[Tensor, "1 3 h w"]:
    """An image of a view's size, enlarged as far as the network needs it, its border repeated to whole strides."""
    zoom = _zoom(*size)
    height, width = (round(zoom * side) for side in size)
    large = functional.interpolate(
        image.permute(2, 0, 1)[None].float(), (height, width), mode="bicubic", align_corners=False
    ).clamp(0, 1)
    return functional.pad(large, (0, -width % STRIDE, 0, -height % STRIDE), mode="replicate")
