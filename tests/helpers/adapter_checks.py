"""What every adapter must do, whatever the set: checked on fixtures that the tests write."""

import importlib.util
import os
import resource
import shutil
import time
from pathlib import Path
from types import ModuleType

import pytest
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Sweep, View

ADAPTER_TESTS = Path(__file__).parents[1] / "datasets" / "adapters"


def fixtures(name: str) -> ModuleType:
    """The test module of an adapter, for what it writes in the set's layout."""
    path = ADAPTER_TESTS / f"test_{name}.py"
    spec = importlib.util.spec_from_file_location(f"adapter_fixtures_{name}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def protocol(**rules) -> Protocol:
    return Protocol(name="test", source="test", **rules)


def tenths(view: View) -> int:
    """A view's time in tenths of a second."""
    assert view.time is not None
    return round(10 * view.time)


def valid(view: View) -> Tensor:
    """A view's mask of valid pixels."""
    assert view.load_mask is not None
    return view.load_mask()


def sky(view: View) -> Tensor:
    """A view's mask of the sky."""
    assert view.load_sky is not None
    return view.load_sky()


def moving(view: View) -> dict[str, Tensor]:
    """A view's masks of what moves."""
    assert view.load_moving is not None
    return view.load_moving()


def sweep(view: View) -> Sweep:
    """A view's LiDAR sweep."""
    assert view.load_sweep is not None
    return view.load_sweep()


def refused(folder: Path, said: str, **rules) -> None:
    """The scene does not open, and one line says why."""
    with pytest.raises(DataError, match=said) as caught:
        open_scene(folder, protocol(**rules))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def without(path: Path, folder: Path, said: str, **rules) -> None:
    """The scene does not open without a file or with rubbish in it; then it is put back."""
    kept = path.read_bytes()
    path.unlink()
    refused(folder, said, **rules)
    path.write_bytes(b"\x00\x01 rubbish")
    refused(folder, path.name.replace(".", r"\."), **rules)
    path.write_bytes(kept)
    open_scene(folder, protocol(**rules))


def opens_in_bounds(folder: Path, views: int, *, seconds: float = 15, mb: float = 200, **rules):
    """The scene with many views opens within bounds of time and of added peak memory.

    Time is the process's own, so that a busy machine does not count. The largest resident set never
    falls, so its growth bounds what opening took.
    """
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    scene = open_scene(folder, protocol(**rules))
    took = time.process_time() - start
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 2**10
    assert len(scene.views) == views
    assert took < seconds
    assert grown < mb
    return scene


def hard_links(source: Path, targets: list[Path]) -> None:
    """One small file under many names; copies where a file system has no links."""
    for target in targets:
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source, target)
        except OSError:
            shutil.copy(source, target)
