"""The photometric loss and SSIM as a metric, on two random images."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels import loss as native
from splatproof.metrics import ssim as metrics
from splatproof.reference.supervision import losses
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional

CASES = (Case(size=(320, 240), quick=True), Case(size=(1600, 1200)))
REFLECTED = "images are mirrored at their borders, where the definition sees black"


def images(size: Size) -> Problem:
    """A blurred random image and a noisy copy; the gradient is by the first."""
    width, height = size
    draw = torch.Generator().manual_seed(width + height)
    truth = losses.blur(torch.rand(height, width, 3, generator=draw))
    noisy = (truth + 0.05 * torch.randn(height, width, 3, generator=draw)).clamp(0, 1)
    return Problem(leaves={"image": noisy}, given={"truth": truth}, cotangent=torch.ones(()))


def scored(size: Size) -> Problem:
    """The same pair for a metric, which has no backward pass."""
    pair = images(size)
    return Problem(leaves=pair.leaves, given=pair.given)


def compares(function: Callable[[Tensor, Tensor], Tensor]) -> Callable[..., Any]:
    """`start` of a function of image and truth."""

    def call(leaves: Leaves, given: Mapping[str, Any]) -> Tensor:
        return function(leaves["image"], given["truth"].to(leaves["image"].dtype))

    return functional(call)


def planes(image: Tensor) -> Tensor:
    """[h, w, c] as kornia takes it: [1, c, h, w]."""
    return image.permute(2, 0, 1)[None]


def kornia_photometric(image: Tensor, truth: Tensor) -> Tensor:
    """L1 and SSIM of kornia with the weights of the training loss.

    Args:
        image: Image, values in [0, 1].
        truth: Image of the same size that it is compared with, values in [0, 1].
    """
    from kornia.losses import ssim_loss  # slow to import, needed here alone

    # kornia's loss is (1 - SSIM) / 2
    dissimilarity = 2 * ssim_loss(planes(image), planes(truth), losses.WINDOW)
    return 0.8 * (image - truth).abs().mean() + 0.2 * dissimilarity


def kornia_ssim(image: Tensor, truth: Tensor) -> Tensor:
    """Mean of kornia's SSIM map.

    Args:
        image: Image, values in [0, 1].
        truth: Image of the same size that it is compared with, values in [0, 1].
    """
    from kornia.metrics import ssim

    return ssim(planes(image), planes(truth), losses.WINDOW).mean()


def skimage_ssim(image: Tensor, truth: Tensor) -> Tensor:
    """scikit-image with the Gaussian window of the definition; it crops the borders.

    Args:
        image: Image, values in [0, 1].
        truth: Image of the same size that it is compared with, values in [0, 1].
    """
    from skimage.metrics import structural_similarity

    value: Any = structural_similarity(
        image.numpy(), truth.numpy(), data_range=1.0, channel_axis=-1, gaussian_weights=True,
        sigma=losses.SIGMA, use_sample_covariance=False,
    )  # fmt: skip
    return torch.tensor(float(value), dtype=torch.float64)


def opencv_ssim(image: Tensor, truth: Tensor) -> Tensor:
    """The metric that results are scored with.

    Args:
        image: Image, values in [0, 1].
        truth: Image of the same size that it is compared with, values in [0, 1].
    """
    return torch.tensor(metrics.ssim_3dgs(image, truth), dtype=torch.float64)


def torch_ssim(image: Tensor, truth: Tensor) -> Tensor:
    """Mean of the reference's SSIM map.

    Args:
        image: Image, values in [0, 1].
        truth: Image of the same size that it is compared with, values in [0, 1].
    """
    return losses.ssim_map(image, truth).mean()


def label(size: Size) -> str:
    """E.g. 320x240."""
    return f"{size[0]}x{size[1]}"


LOSS = Component(
    name="loss",
    problem=images,
    reference=Twin(name="reference float64", start=compares(losses.photometric),
                   dtype=torch.float64),
    twins=(
        *(Twin(name=f"cpu {level}", start=compares(native.photometric), level=level)
          for level in _ext.simd_levels()),
        Twin(name="torch", start=compares(losses.photometric)),
        Twin(name="kornia", start=compares(kornia_photometric), approximates=REFLECTED),
    ),
    usual=f"cpu {_ext.simd_levels()[-1]}", judged=(250, 140), tiny=(24, 20), cases=CASES,
    label=label,
)  # fmt: skip

SSIM = Component(
    name="ssim",
    problem=scored,
    reference=Twin(name="reference float64", start=compares(torch_ssim), dtype=torch.float64),
    twins=(
        Twin(name="OpenCV float64", start=compares(opencv_ssim)),
        Twin(name="torch", start=compares(torch_ssim)),
        Twin(name="kornia", start=compares(kornia_ssim), approximates=REFLECTED),
        Twin(name="scikit-image", start=compares(skimage_ssim), approximates="borders are cropped"),
    ),
    usual="OpenCV float64", judged=(250, 140), tiny=(24, 20), cases=CASES, label=label,
)  # fmt: skip
