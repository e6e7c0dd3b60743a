"""What users add: methods, metrics and adapters, by entry points of packages or by plug-in files."""

import functools
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from splatproof.base.errors import UsageError
from splatproof.base.plugin_files import PluginFile, plugin_files

T = TypeVar("T")


def with_plugins(built_in: Mapping[str, T], group: str, kind: type[T]) -> dict[str, T]:
    """The built-in table and what installed packages and plug-in files add to it.

    Args:
        built_in: Our own entries by name; they come first and cannot be replaced.
        group: Name of the entry point group, "splatproof.methods" for example.
        kind: Type that each entry point must load to, and whose instances at the top level of a
            plug-in file are taken.

    Returns: All, by name; the entry point's name is the entry's, or the `name` of what a file has.

    Raises: UsageError, naming package and entry point or the file, if one cannot be imported, is of
        another type, or has a name that is taken.
    """
    table = dict(built_in)
    for point in _installed(entry_points, group, tuple(sys.path)):
        where = f"{_package(point)}: entry point {point.name} = {point.value} in {group}"
        if point.name in table:
            raise UsageError(f"{where}: the name is taken; give it another one or uninstall it")
        try:
            found = point.load()
        except Exception as error:  # a package that is not ours may raise anything on import
            raise UsageError(
                f"{where}: cannot be loaded ({error!r}); uninstall or mend it"
            ) from error
        if not isinstance(found, kind):
            raise UsageError(f"{where}: is a {type(found).__name__}, expected a {kind.__name__}")
        table[point.name] = found
    for file in plugin_files():
        for name, found in offered(file, kind).items():
            if table.setdefault(name, found) is not found:
                raise UsageError(
                    f"plugin {file.path}: its {kind.__name__} is called {name!r}, and that name is "
                    "taken; give it another one"
                )
    return table


def offered(file: PluginFile, kind: type[T]) -> dict[str, T]:
    """What a plug-in file has of one kind, by name.

    Args:
        file: A file that is loaded.
        kind: Type of what is looked for, with an attribute `name`.

    Returns: Every instance at the file's top level, those that it imports included.
    """
    values = vars(file.module).values()
    return {str(getattr(one, "name", "")): one for one in values if isinstance(one, kind)}


@functools.cache
def _installed(
    look: Callable[..., Iterable[EntryPoint]], group: str, path: tuple[str, ...]
) -> tuple[EntryPoint, ...]:
    """Entry points of a group by name: every package's metadata is read for them, 50 ms each time.

    What is installed while a process runs is seen by the next one.
    """
    del path
    return tuple(sorted(look(group=group), key=lambda point: point.name))


def _package(point: EntryPoint) -> str:
    return f"package {point.dist.name}" if point.dist is not None else "an installed package"
