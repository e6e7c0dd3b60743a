"""pycolmap, imported so that SIGTERM and crashes do what they did before: its log takes them.

Ctrl-C waits for the import: native code would make "initialization failed" of it.
Import it from here: `from splatproof.datasets.colmap_library import pycolmap`.
"""

from splatproof.base.signals import held_back, kept

with held_back(), kept():
    import pycolmap

__all__ = ["FEATURES", "MATCHES", "pycolmap"]

FEATURES = 8192 * (128 + 6 * 4)
"""Most bytes of one photo's descriptors and keypoints in COLMAP's database, whose writers end the process on a full disk."""
MATCHES = 20_000
"""Bytes of one pair's matches there, as a rule."""
