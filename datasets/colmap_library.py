"""pycolmap, imported so that SIGTERM and crashes do what they did before: its log takes them.

Ctrl-C waits for the import: native code would make "initialization failed" of it.
Import it from here: `from splatproof.datasets.colmap_library import pycolmap`.
"""

from splatproof.base.signals import held_back, kept

with held_back(), kept():
    import pycolmap

__all__ = ["pycolmap"]
