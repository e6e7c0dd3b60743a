"""What a case costs and what it leaves: CPU time, memory, bytes, hashes."""

import hashlib
import json
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatproof.base.files import sha256
from splatproof.reference.types.scene import Scene


def cpu_seconds() -> float:
    """User and system seconds of all threads of this process, and of processes that it ended."""
    both = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(used.ru_utime + used.ru_stime for used in both)


@contextmanager
def timed(stages: dict[str, float], name: str) -> Iterator[None]:
    """Add the wall seconds of the `with` block to stages[name].

    Args:
        stages: Seconds by stage, changed in place.
        name: Name of the stage.
    """
    started = time.perf_counter()
    yield
    stages[name] = stages.get(name, 0.0) + time.perf_counter() - started


def bytes_on_disk(folder: Path) -> int:
    """Bytes of all files below `folder`."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def arrays_sha256(folder: Path) -> str:
    """Hash of the names and hashes of a saved model's array files: all but its .json ones.

    The .json files say who wrote the model and when releases differ they do; arrays do not.
    """
    files = [p for p in sorted(folder.rglob("*")) if p.is_file() and p.suffix != ".json"]
    listing = [(path.relative_to(folder).as_posix(), sha256(path)) for path in files]
    return hashlib.sha256(json.dumps(listing).encode()).hexdigest()


def split_sha256(scene: Scene) -> str:
    """Hash of the lists of train and test names."""
    names = {
        "train": [view.name for view in scene.train_views],
        "test": [view.name for view in scene.test_views],
    }
    return hashlib.sha256(json.dumps(names).encode()).hexdigest()
