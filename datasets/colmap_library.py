"""pycolmap, imported so that signals do what they did before: its log takes SIGTERM and crashes.

Import it from here: `from splatproof.datasets.colmap_library import pycolmap`.
"""

from splatproof.base.signals import kept

with kept():
    import pycolmap

__all__ = ["pycolmap"]
