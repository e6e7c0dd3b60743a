"""Pure metric functions on arrays, their descriptions, and the protocols they are scored under.

Every built-in per-image metric can be called from here by its exact name:
`splatproof.metrics.psnr(image, target, mask)`, images height x width x 3 in [0, 1], mask True where a
pixel counts. `find_metric(name).function` finds those of plug-ins too.
"""

import importlib

_WHERE = {
    "delta_e_2000": "colour_difference",
    "delta_e_76": "colour_difference",
    "find_metric": "registry",
    "flip": "ldr_flip",
    "gradient_l1": "gradient",
    "l1": "pixel",
    "lpips_alex_m11": "lpips",
    "lpips_vgg_01": "lpips",
    "lpips_vgg_m11": "lpips",
    "ms_ssim_kornia": "ssim",
    "psnr": "pixel",
    "ssim_3dgs": "ssim",
    "ssim_contrast": "ssim",
    "ssim_kornia": "ssim",
    "ssim_skimage": "ssim",
    "ssim_valid": "ssim",
}
"""Module of each name, imported when it is asked for."""


def __getattr__(name: str) -> object:
    """A metric by its name, imported at its first use."""
    if name not in _WHERE:
        raise AttributeError(f"module 'splatproof.metrics' has no attribute {name!r}")
    found = getattr(importlib.import_module(f"splatproof.metrics.{_WHERE[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """The metrics' names."""
    return sorted(_WHERE)
