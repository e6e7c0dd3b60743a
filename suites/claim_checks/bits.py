"""Whether two ways to the same model end in the same bytes."""

import functools
import hashlib
import tempfile
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from splatproof.base.processes import Worker
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.writer import write_packed
from splatproof.methods.storage.ply import read_ply, write_ply
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.claim_checks.check import Check, Measurement
from splatproof.suites.claim_checks.trained import SETTINGS, fit, stored

STEPS, QUICK_STEPS = 200, 30


class Stopped(Exception):
    """A run was broken off."""


def differing(one: bytes, other: bytes) -> int:
    """How many bytes of two files differ; what one is longer counts too.

    Args:
        one: A file.
        other: Another one.
    """
    common = min(len(one), len(other))
    a, b = (np.frombuffer(data[:common], dtype=np.uint8) for data in (one, other))
    return int((a != b).sum()) + abs(len(one) - len(other))


Fit = Callable[[str, int, Path], bytes]
"""fit(method, steps, folder): the stored model's bytes."""


def twice(one: Fit, other: Fit, how: str) -> Callable[[bool, Path], Measurement]:
    """A check that fits each method in two ways and counts the bytes that differ.

    Args:
        one: The first way.
        other: The second.
        how: What differs between them, in words.
    """

    def measure(reduced: bool, folder: Path) -> Measurement:
        steps = QUICK_STEPS if reduced else STEPS
        values, sizes = [], []
        for method in SETTINGS:
            a, b = (
                way(method, steps, folder / f"{method}{i}") for i, way in enumerate((one, other))
            )
            values.append(float(differing(a, b)))
            sizes.append(len(a))
        named = ", ".join(f"{m} ({n:,} bytes)" for m, n in zip(SETTINGS, sizes, strict=True))
        return Measurement(values=tuple(values), compared=f"{how}, {steps} steps of {named}")

    return measure


def _straight(method: str, steps: int, folder: Path, *, seed: int = 0, threads: int = 1) -> bytes:
    """A fit from beginning to end, without a checkpoint."""
    return stored(fit(method, steps, Run(seed=seed, threads=threads)), folder)


@functools.cache
def _kept(method: str, steps: int) -> bytes:
    with tempfile.TemporaryDirectory(prefix="splatproof-") as folder:
        return _straight(method, steps, Path(folder))


def _once(method: str, steps: int, folder: Path) -> bytes:
    """A straight fit on one thread, shared by the checks that hold another against it."""
    del folder
    return _kept(method, steps)


def _on_two_threads(method: str, steps: int, folder: Path) -> bytes:
    """The same on two threads."""
    return _straight(method, steps, folder, threads=2)


def _broken_off(method: str, steps: int, folder: Path) -> bytes:
    """A fit that ends by an error half-way, and is continued from its checkpoint."""
    reached = False

    def stop(step: int, total: int, values: dict[str, float]) -> None:
        nonlocal reached
        del values
        if 2 * step >= total:
            reached = True
            raise Stopped

    work = folder / "work"
    options = {"threads": 1, "folder": work, "checkpoint_seconds": 0.0}
    try:
        fit(method, steps, Run(**options, report=stop))
    except Stopped:
        pass
    assert reached, f"{method}: nothing was reported half-way"
    first = []
    model = fit(method, steps, Run(**options, report=lambda step, *_: first.append(step)))
    assert min(first) > 1, f"{method}: it started over"
    return stored(model, folder)


def in_memory(model: Gaussians) -> str:
    """Hash of all tensors of a model.

    Args:
        model: What is hashed.
    """
    digest = hashlib.sha256()
    for name in FIELDS:
        digest.update(getattr(model, name).contiguous().numpy().tobytes())
    return digest.hexdigest()


def _unpack(connection: Connection, path: Path) -> None:
    connection.send(in_memory(read_packed(path, threads=2)[0]))


def _elsewhere(reduced: bool, folder: Path) -> Measurement:
    """1 where a packed file decodes to other bits in another process on other threads, else 0."""
    model = fit("3dgs", QUICK_STEPS if reduced else STEPS, Run(threads=1))
    assert isinstance(model, ExplicitModel)
    path = folder / "model.spgs"
    folder.mkdir(parents=True, exist_ok=True)
    write_packed(path, model.model)
    here = in_memory(read_packed(path, threads=1)[0])
    with Worker(_unpack, path) as worker:
        there = worker.receive()
    return Measurement(
        values=(float(here != there),),
        compared=f"{model.primitives:,} Gaussians decoded here on one thread, in another process on two",
    )


def _ply(reduced: bool, folder: Path) -> Measurement:
    """1 where a .ply does not give back the bits of the model that was written, else 0."""
    model = fit("3dgs", QUICK_STEPS if reduced else STEPS, Run(threads=1))
    assert isinstance(model, ExplicitModel)
    folder.mkdir(parents=True, exist_ok=True)
    first, second = folder / "first.ply", folder / "second.ply"
    write_ply(first, model.model)
    write_ply(second, read_ply(first)[0])
    count = differing(first.read_bytes(), second.read_bytes())
    return Measurement(
        values=(float(count),), compared=f"a .ply of {model.primitives:,} Gaussians and its copy"
    )


def _other_seed(method: str, steps: int, folder: Path) -> bytes:
    """The control: another seed gives another model."""
    return _straight(method, steps, folder, seed=1)


BITS = {
    "same_seed": Check(measure=twice(_once, _straight, "one seed twice"), unit="bytes",
                       seconds=(12.0, 4.0)),
    "other_seed": Check(measure=twice(_once, _other_seed, "two seeds"), unit="bytes",
                        seconds=(12.0, 4.0)),
    "continued": Check(measure=twice(_once, _broken_off, "straight, and stopped half-way"),
                       unit="bytes", seconds=(14.0, 5.0)),
    "threads": Check(measure=twice(_once, _on_two_threads, "one thread and two"), unit="bytes",
                     seconds=(12.0, 4.0)),
    "packed_elsewhere": Check(measure=_elsewhere, unit="", seconds=(8.0, 5.0)),
    "ply_copy": Check(measure=_ply, unit="bytes", seconds=(4.0, 2.0)),
}  # fmt: skip
