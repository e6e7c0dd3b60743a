"""The native photometric loss: twin of splatproof.reference.supervision.losses.photometric, in float32.

`photometric(image, truth, *, dssim=0.2, mask=None)` computes the value and the gradient by the image in
one pass, so its backward costs one multiplication. The truth gets no gradient.
"""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.threads import use_threads


def photometric(
    image: Float[Tensor, "h w c"],
    truth: Float[Tensor, "h w c"],
    *,
    dssim: float = 0.2,
    mask: Bool[Tensor, "h w"] | None = None,
) -> Float[Tensor, ""]:
    """Training loss (1 - l) mean|image - truth| + l (1 - mean SSIM), over valid pixels.

    Args:
        image: Render; not clamped. It alone gets a gradient.
        truth: Photo in [0, 1].
        dssim: Weight l in [0, 1].
        mask: True where the photo is valid; None: all. Invalid pixels are black in both images, as
            what lies outside them, so they pull on nothing, not even through the SSIM window.

    Returns: The loss; 0 where no pixel is valid.

    Raises: ValueError unless image and truth are float32 on the CPU, of one shape that is not empty,
        and the mask is boolean of theirs.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Eq. 7; masks and the gradient that is found
        together with the value: ours.
    """
    for name, tensor in (("image", image), ("truth", truth)):
        if tensor.dtype != torch.float32 or tensor.device.type != "cpu":
            raise ValueError(
                f"{name} is {tensor.dtype} on {tensor.device}, expected torch.float32 on the CPU"
            )
        if tensor.ndim != 3 or tensor.shape != image.shape or tensor.numel() == 0:
            raise ValueError(
                f"{name} has shape {tuple(tensor.shape)}, expected [h, w, c], not empty, the same "
                "for image and truth"
            )
    if mask is not None and (mask.dtype != torch.bool or mask.shape != image.shape[:2]):
        raise ValueError(
            f"mask is {mask.dtype} {tuple(mask.shape)}, expected torch.bool {tuple(image.shape[:2])}"
        )
    if truth.requires_grad:
        raise ValueError("truth requires a gradient, but the loss has none by it; detach it")
    return _Photometric.apply(image, truth, dssim, mask)


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, truth: Tensor, dssim: float, mask: Tensor | None):
        gradient = (
            torch.empty_like(image, memory_format=torch.contiguous_format)
            if ctx.needs_input_grad[0]
            else None
        )
        use_threads()
        value = _ext.photometric(
            image.detach().contiguous(), truth.contiguous(),
            None if mask is None else mask.contiguous(), dssim, gradient,
        )  # fmt: skip
        ctx.gradient = gradient
        return image.new_tensor(value)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        return ctx.gradient * grad_outputs[0], None, None, None
