"""A name for the code that results depend on: where it changes, cases run again."""

import hashlib
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import torch

import splatproof
from splatproof.methods.registry import get_method
from splatproof.metrics.registry import find_metric

CODE = (".py", ".so", ".pyd")
"""Ends of files that are code."""
DIGITS = 12


def code_key(methods: Iterable[str], metrics: Iterable[str]) -> str:
    """Letters that change with the code of splatproof, of the packages of methods and metrics, and with torch.

    A finished case is kept where its settings and data are the same, whatever code made it; a check
    for regressions must not, so its results lie in a folder of this name.

    Args:
        methods: Names of methods.
        metrics: Names of metrics.
    Raises: UsageError for a method or a metric that does not exist.
    """
    places = {Path(splatproof.__file__).parent}
    functions: list[Callable[..., object]] = [get_method(name).fit for name in methods]
    functions += [find_metric(name).function for name in metrics]
    for function in map(_inner, functions):
        module = sys.modules[function.__module__]
        top = sys.modules[module.__name__.partition(".")[0]]
        places.add(_place(top.__file__ or module.__file__ or ""))
    found = hashlib.sha256(torch.__version__.encode())
    for place in sorted(places):
        found.update(_digest(place))
    return found.hexdigest()[:DIGITS]


def _inner(function: Callable[..., object]) -> Callable[..., object]:
    """The function in a partial one, whose module is functools."""
    return _inner(function.func) if isinstance(function, partial) else function


def _place(file: str) -> Path:
    """A module's own file; of a package its folder."""
    path = Path(file)
    return path.parent if path.name == "__init__.py" else path


def _digest(place: Path) -> bytes:
    """Hash of a file, or of all code in a folder and the folders that it links to."""
    found = hashlib.sha256()
    for path in sorted(_files(place)):
        found.update(f"{path.relative_to(place.parent)}\0".encode() + path.read_bytes())
    return found.digest()


def _files(place: Path) -> Iterable[Path]:
    if place.is_file():
        return [place]
    inside = (path for path in place.iterdir() if not path.name.startswith((".", "__pycache__")))
    return [file for path in inside for file in (_files(path) if path.is_dir() else _code(path))]


def _code(path: Path) -> list[Path]:
    return [path] if path.suffix in CODE else []
