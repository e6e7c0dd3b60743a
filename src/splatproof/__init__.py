"""splatproof: a test-first evaluation and benchmark harness for large-scale Gaussian splatting.

>>> import torch
>>> import splatproof as sp
>>> round(sp.metrics.psnr(torch.zeros(2, 2, 3), torch.full((2, 2, 3), 0.1)), 4)
20.0
"""

import importlib

_WHERE = {
    "Camera": "reference.types.camera",
    "DataError": "base.errors",
    "Fitted": "api.fitting",
    "MissingError": "base.errors",
    "SplatproofError": "base.errors",
    "UsageError": "base.errors",
    "camera_view": "reference.types.scene",
    "fit": "api.fitting",
    "load": "api.models",
    "open_scene": "api.scenes",
    "rasterize": "api.models",
    "results_frame": "api.results",
    "use_plugin": "api.plugins",
}
"""Module of each name. They are imported when they are asked for: torch alone takes seconds, which
neither `bench --help` nor a worker's start should wait for. `__init__.pyi` tells type checkers."""


def __getattr__(name: str) -> object:
    """A name of the API, imported at its first use."""
    if (
        name == "__version__"
    ):  # metadata takes longer to read than all that `bench` needs to hear ctrl-C
        found = importlib.import_module("importlib.metadata").version("splatproof")
        globals()[name] = found
        return found
    if name == "metrics":
        return importlib.import_module("splatproof.metrics")
    if name not in _WHERE:
        raise AttributeError(f"module 'splatproof' has no attribute {name!r}")
    found = getattr(importlib.import_module(f"splatproof.{_WHERE[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """The API's names."""
    return sorted([*_WHERE, "__version__", "metrics"])
