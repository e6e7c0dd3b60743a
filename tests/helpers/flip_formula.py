"""LDR-FLIP written from the paper, with plain two-dimensional filters, as an oracle.

Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images".
"""

import numpy as np
from scipy.ndimage import convolve
from skimage.color import rgb2xyz

PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * np.pi / 180
WHITE = rgb2xyz(np.ones((1, 1, 3)))[0, 0]
TO_XYZ = np.array([rgb2xyz(np.eye(3)[k][None, None])[0, 0] for k in range(3)]).T


def flip_formula(target, image):
    """The error map of two h x w x 3 sRGB images in [0, 1]."""
    colour = _colour_difference(_filtered(target), _filtered(image))
    return colour ** (1 - _feature_difference(target, image))


def _linear(srgb):
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _opponent(srgb):
    """Linearised CIELab (Y, Cx, Cz)."""
    x, y, z = np.moveaxis(_linear(srgb) @ TO_XYZ.T / WHITE, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def _filtered(srgb):
    """Contrast sensitivity filters, then back to linear RGB, clamped."""
    parameters = ((1, 0.0047, 0, 1e-5), (1, 0.0053, 0, 1e-5), (34.1, 0.04, 13.5, 0.025))
    radius = int(np.ceil(3 * np.sqrt(0.04 / (2 * np.pi**2)) * PIXELS_PER_DEGREE))
    line = np.arange(-radius, radius + 1) / PIXELS_PER_DEGREE
    squared = line[:, None] ** 2 + line[None] ** 2
    channels = np.moveaxis(_opponent(srgb), -1, 0)
    seen = []
    for channel, (a1, b1, a2, b2) in zip(channels, parameters, strict=True):
        kernel = a1 * np.sqrt(np.pi / b1) * np.exp(-(np.pi**2) * squared / b1)
        kernel += a2 * np.sqrt(np.pi / b2) * np.exp(-(np.pi**2) * squared / b2)
        seen.append(convolve(channel, kernel / kernel.sum(), mode="nearest"))
    y = (seen[0] + 16) / 116
    xyz = np.stack([seen[1] / 500 + y, y, y - seen[2] / 200], axis=-1) * WHITE
    return np.clip(xyz @ np.linalg.inv(TO_XYZ).T, 0, 1)


def _hunt_lab(linear):
    """CIELab with the Hunt effect: chroma scaled by 0.01 L."""
    ratio = linear @ TO_XYZ.T / WHITE
    delta = 6 / 29
    f = np.where(ratio > delta**3, np.cbrt(ratio), ratio / (3 * delta**2) + 4 / 29)
    lightness = 116 * f[..., 1] - 16
    a, b = 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])
    return np.stack([lightness, 0.01 * lightness * a, 0.01 * lightness * b], axis=-1)


def _hyab(first, second):
    difference = first - second
    return np.abs(difference[..., 0]) + np.hypot(difference[..., 1], difference[..., 2])


def _colour_difference(first, second):
    """HyAB to the power 0.7, mapped so that 0.4 of the largest becomes 0.95."""
    green, blue = (_hunt_lab(np.array([[c]], dtype=float)) for c in ((0, 1, 0), (0, 0, 1)))
    largest = _hyab(green, blue)[0, 0] ** 0.7
    power, knee = _hyab(_hunt_lab(first), _hunt_lab(second)) ** 0.7, 0.4 * largest
    above = 0.95 + (power - knee) / (largest - knee) * 0.05
    return np.where(power < knee, 0.95 / knee * power, above)


def _feature_difference(first, second):
    """Square root of the larger change of edges and points, over sqrt 2."""
    deviation = 0.5 * 0.082 * PIXELS_PER_DEGREE
    radius = int(np.ceil(3 * deviation))
    x = np.arange(-radius, radius + 1)[None]
    gauss = np.exp(-(x**2 + x.T**2) / (2 * deviation**2))
    changes = []
    for kernel in (-x * gauss, (x**2 / deviation**2 - 1) * gauss):
        kernel = np.where(kernel > 0, kernel / kernel[kernel > 0].sum(), kernel)
        kernel = np.where(kernel < 0, kernel / -kernel[kernel < 0].sum(), kernel)
        strengths = []
        for srgb in (first, second):
            grey = (_opponent(srgb)[..., 0] + 16) / 116
            parts = [convolve(grey, k, mode="nearest") for k in (kernel, kernel.T)]
            strengths.append(np.hypot(*parts))
        changes.append(np.abs(strengths[0] - strengths[1]))
    return (np.maximum(*changes) / np.sqrt(2)) ** 0.5
