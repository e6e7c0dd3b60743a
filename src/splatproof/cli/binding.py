"""Commands made from one function: each a subcommand that shows only the options it obeys."""

import inspect
from collections.abc import Callable, Collection, Mapping
from typing import Any, get_type_hints


def bound(
    function: Callable[..., int],
    fixed: Mapping[str, Any],
    *,
    without: Collection[str] = (),
    kinds: Mapping[str, Any] | None = None,
    title: str,
) -> Callable[..., int]:
    """A command that calls `function` with some of its parameters given or left at their defaults.

    Args:
        function: What the command does; its docstring is the help.
        fixed: Values of parameters that the command line does not have.
        without: Names of parameters that the command line does not have and that keep their defaults.
        kinds: Annotations that replace those of the function, by the parameter's name.
        title: First line of the help; the function's docstring follows.
    Returns: The command, with the signature that tyro reads.
    """
    hints = get_type_hints(function, include_extras=True) | dict(kinds or {})
    gone = {*fixed, *without}
    parameters = [
        parameter.replace(annotation=hints[name])
        for name, parameter in inspect.signature(function).parameters.items()
        if name not in gone
    ]

    def command(**options: Any) -> int:
        return function(**fixed, **options)

    # tyro reads the signature made here, not that of a test's type-checking wrapper
    command = inspect.unwrap(command)
    command.__doc__ = f"{title}\n\n{inspect.cleandoc(function.__doc__ or '')}"
    command.__annotations__ = {name: hint for name, hint in hints.items() if name not in gone}
    command.__signature__ = inspect.Signature(parameters)
    return command
