"""What can be reached from an object: everything that it holds, however deep, and files that it opens."""

import functools
import gc
import inspect
import sys
import types
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from torch import Tensor

LEAVES = (
    type,
    types.ModuleType,
    types.CodeType,
    types.BuiltinFunctionType,
    Path,
    Tensor,
    np.generic,
)
"""What is not looked into: it holds nothing of the object's own, or is judged as a whole."""
_opened: list[str] | None = None


def reachable(start: object) -> Iterator[object]:
    """Every object that another holds: attributes, items, closures, defaults, arguments of partials.

    Modules and classes are left out: they are the same whatever object one starts from.

    Args:
        start: The object; it is the first.
    """
    seen: dict[int, object] = {}  # objects too, so that no id is given twice
    ahead = [start]
    while ahead:
        thing = ahead.pop()
        if id(thing) in seen:
            continue
        seen[id(thing)] = thing
        yield thing
        if isinstance(thing, LEAVES):
            continue
        if isinstance(thing, types.FunctionType):
            ahead += [thing.__closure__, thing.__defaults__, thing.__kwdefaults__, vars(thing)]
        elif isinstance(thing, weakref.ref):
            ahead.append(thing())
        else:
            ahead += gc.get_referents(thing)


def called(start: object) -> Iterator[object]:
    """What comes back from everything reachable that can be called without an argument.

    That is every function, method and partial, and every method and property of an object of ours,
    which may do with the object's fields what no loader does. What raises is left out.
    """
    for thing in list(reachable(start)):
        calls = [thing] if isinstance(thing, functools.partial | types.FunctionType) else []
        calls += [thing] if isinstance(thing, types.MethodType) else []
        if type(thing).__module__.startswith("splatproof"):
            with suppress(Exception):
                names = [name for name in dir(thing) if not name.startswith("__")]
                calls += [functools.partial(getattr, thing, name) for name in names]
                calls += [getattr(thing, name) for name in names]
        for call in calls:
            with suppress(Exception):
                if callable(call) and _takes_nothing(call):
                    yield call()


def _takes_nothing(call) -> bool:
    try:
        inspect.signature(call).bind()
    except (TypeError, ValueError):
        return isinstance(call, functools.partial)  # of a builtin, which has no signature
    return True


@contextmanager
def opened_files() -> Iterator[list[str]]:
    """Collects the paths of the files that Python opens inside the block."""
    global _opened
    _hook()
    _opened = []
    try:
        yield _opened
    finally:
        _opened = None


@functools.cache
def _hook() -> None:
    sys.addaudithook(_hear)  # once and for good: Python has no way to take one back


def _hear(event: str, arguments: tuple) -> None:
    if event == "open" and _opened is not None and isinstance(arguments[0], str):
        _opened.append(arguments[0])
