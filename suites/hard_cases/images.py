"""Hard cases of the image metrics."""

from collections.abc import Callable

import torch
from torch import Tensor

from splatproof.metrics.registry import find_metric
from splatproof.suites.hard_cases.case import HardCase, fixed

NAMES = ("psnr", "ssim_3dgs", "ssim_valid", "flip", "l1")


def _metric(name: str) -> Callable[[Tensor, Tensor], Tensor]:
    """1 / (1 + value), so that the infinite PSNR of equal images is a finite 0."""

    def run(image: Tensor, truth: Tensor) -> Tensor:
        value = find_metric(name).function(image, truth, None)
        return torch.tensor([1 / (1 + value)], dtype=image.dtype)

    return run


def _picture(seed: int, h: int = 16, w: int = 17) -> Tensor:
    return torch.rand(h, w, 3, generator=torch.Generator().manual_seed(seed))


def _with(value: float) -> Tensor:
    image = _picture(1)
    image[3, 4, 1] = value
    return image


CASES = tuple(
    case
    for name in NAMES
    for case in (
        HardCase(component=name, name="identical images", inputs=fixed(_picture(0), _picture(0)),
                 run=_metric(name)),
        HardCase(component=name, name="constant images",
                 inputs=fixed(torch.full((16, 17, 3), 0.25), torch.full((16, 17, 3), 0.75)),
                 run=_metric(name)),
        HardCase(component=name, name="different sizes",
                 inputs=fixed(_picture(0), _picture(0, 17, 16)), run=_metric(name),
                 expect="refused"),
        HardCase(component=name, name="NaN pixel", inputs=fixed(_with(torch.nan), _picture(0)),
                 run=_metric(name), expect="refused"),
        HardCase(component=name, name="value outside [0, 1]", inputs=fixed(_with(1.5), _picture(0)),
                 run=_metric(name), expect="refused"),
        HardCase(component=name, name="one pixel", inputs=fixed(_picture(0, 1, 1), _picture(1, 1, 1)),
                 run=_metric(name),
                 expect="refused" if name.startswith("ssim") else "finite"),
    )
)  # fmt: skip
