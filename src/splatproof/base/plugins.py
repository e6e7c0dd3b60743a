"""What other installed packages add: methods, metrics and adapters found through entry points."""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from splatproof.base.errors import UsageError

T = TypeVar("T")


def with_plugins(built_in: Mapping[str, T], group: str, kind: type[T]) -> dict[str, T]:
    """The built-in table and what installed packages add to it under an entry point group.

    Args:
        built_in: Our own entries by name; they come first and cannot be replaced.
        group: Name of the entry point group, "splatproof.methods" for example.
        kind: Type that each entry point must load to.

    Returns: Both, by name; the entry point's name is the entry's.

    Raises: UsageError, naming package and entry point, if one cannot be imported, is of another
        type, or has a name that is taken.
    """
    table = dict(built_in)
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
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
    return table


def _package(point: EntryPoint) -> str:
    return f"package {point.dist.name}" if point.dist is not None else "an installed package"
