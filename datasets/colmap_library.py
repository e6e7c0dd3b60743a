"""pycolmap, imported so that SIGTERM and crashes do what they did before: its log takes them.

Import it from here: `from splatproof.datasets.colmap_library import pycolmap`.
"""

from splatproof.base.signals import kept

with kept():
    import pycolmap

__all__ = ["pycolmap"]
