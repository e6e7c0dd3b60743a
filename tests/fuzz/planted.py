"""Readers with a fault each, to see that the fuzzer sees it; a program like fuzz.targets."""

import functools
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from fuzz.bounds import SECONDS
from fuzz.layout import Layout
from fuzz.serving import serve
from fuzz.target import Target
from splatproof.base.errors import DataError

INTACT = b"intact"


def _raises(path: Path) -> object:
    return int("three")


def _long(path: Path) -> NoReturn:
    while True:
        pass


def _large(path: Path) -> object:
    return len(b"x" * 288 * 2**20)  # the bound is 256; 400 were too slow on a busy machine


def _huge(path: Path) -> object:
    return len(bytearray(2**40))


def _nan(path: Path) -> object:
    return {"a": [0.0, float("nan")]}


def _nameless(path: Path) -> object:
    raise DataError("not what it should be")


class _Loose(DataError):
    """An error that is told as it is, where ours put what it says on one line."""

    def __str__(self) -> str:
        return str(self.args[0])


def _lines(path: Path) -> object:
    raise _Loose(f"{path}: two\nlines")


def _dies(path: Path) -> object:
    os.abort()


def _hangs(path: Path) -> NoReturn:
    while True:
        time.sleep(1)


def _sound(path: Path) -> object:
    raise DataError(f"{path}: not intact")


READERS: dict[str, Callable[[Path], object]] = {
    "raises": _raises, "long": _long, "large": _large, "huge": _huge, "nan": _nan, "nameless": _nameless,
    "lines": _lines, "dies": _dies, "hangs": _hangs, "sound": _sound,
}  # fmt: skip


OTHER = Layout(lambda data: [(lambda *_: b"damaged", data)], b"".join)
"""Nothing stays as it was."""


def _build(read: Callable[[Path], object], folder: Path) -> Target:
    def guarded(path: Path) -> object:
        return None if path.read_bytes() == INTACT else read(path)

    return Target(path=folder / "x.bin", samples=[INTACT], layout=OTHER, read=guarded)


def _build_late(folder: Path) -> Target:
    """A sound reader that imports modules, which a fresh checkout compiles, when it first reads."""
    imported = False

    def late(path: Path) -> object:
        nonlocal imported
        until = 0 if imported else time.process_time() + SECONDS + 0.1
        while time.process_time() < until:
            pass
        imported = True
        return path.read_bytes()

    return Target(path=folder / "x.bin", samples=[INTACT], layout=OTHER, read=late)


if __name__ == "__main__":
    readers = {name: functools.partial(_build, read) for name, read in READERS.items()}
    serve(Path(sys.argv[1]), readers | {"late": _build_late})
