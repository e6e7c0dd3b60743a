"""splatproof: a test-first evaluation and benchmark harness for large-scale Gaussian splatting."""

from importlib.metadata import version

__version__ = version("splatproof")
