"""pycolmap, imported so that SIGTERM and crashes do what they did before: its log takes them.

Ctrl-C waits for the import: native code would make "initialization failed" of it.
Import it from here: `from splatproof.datasets.colmap_library import pycolmap`.
"""

import numpy as np

from splatproof.base.signals import held_back, kept

with held_back(), kept():
    import pycolmap

__all__ = ["FEATURES", "MATCHES", "has_focal_length", "pycolmap"]

FEATURES = 8192 * (128 + 6 * 4)
"""Most bytes of one photo's descriptors and keypoints in COLMAP's database, whose writers end the process on a full disk."""
MATCHES = 20_000
"""Bytes of one pair's matches there, as a rule."""


def has_focal_length(camera: pycolmap.Camera) -> bool:
    """Whether a camera's parameters are finite and its focal lengths, which a spherical one has none of, positive.

    Args:
        camera: A calibrated camera of any model.
    """
    focal = () if camera.is_spherical() else (camera.focal_length_x, camera.focal_length_y)
    return bool(np.isfinite(camera.params).all()) and all(f > 0 for f in focal)
