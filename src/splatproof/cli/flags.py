"""Options that commands share: how they speak, whom they trust, the user's own plug-in files."""

import inspect
import shlex
from collections.abc import Callable
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import tyro

from splatproof.base.inside import allowing_outside
from splatproof.base.numbers import check_numbers, in_range
from splatproof.base.plugin_files import plugin_files
from splatproof.cli import output

JsonFlag = Annotated[
    bool,
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.arg(help="Print results as JSON, one object a line."),
]
QuietFlag = Annotated[
    bool,
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.arg(help="No logs and no progress on stderr."),
]
AllowOutside = Annotated[
    bool,
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.arg(
        help="Read photos and masks that a scene's files name outside its folder, or that links lead "
        "to. Only for scenes that you trust: what is read is shown in results."
    ),
]
LEAST = {"seed": 0, "threads": 1, "workers": 1, "width": 1, "height": 1}
"""Smallest value of options that mean the same in every command."""


PluginFiles = Annotated[
    tuple[Path, ...],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(
        metavar="FILE.py",
        help="Python file with methods, metrics or adapters of your own; can be given several times.",
    ),
]


def with_flags(
    function: Callable[..., Any], *, plugins: bool, scenes: bool = False
) -> Callable[..., Any]:
    """The command with `--json`, `--quiet`, `--allow-outside` and `--plugin` added.

    The first two say how splatproof.cli.output speaks; plug-ins were loaded before parsing.

    Args:
        function: The command.
        plugins: Whether it takes `--plugin`.
        scenes: Whether it takes `--allow-outside`, since it opens scenes that users name.
    Returns: The command with the signature that tyro reads.
    """

    def command(
        *args: Any,
        json: bool,
        quiet: bool,
        allow_outside: bool = False,
        plugin: object = (),
        **named: Any,
    ) -> Any:
        for name, value in named.items():
            # fields of a dataclass are options of their own
            option = "--" if is_dataclass(value) else f"--{name.replace('_', '-')}"
            check_numbers(value, option)
            if name in LEAST and value is not None:
                in_range(value, option, LEAST[name])
        style = output.Style(json=json, quiet=quiet)
        with output.speaking(style), allowing_outside(allow_outside):
            return function(*args, **named)

    # Tests wrap every function to check its types; tyro would read the wrapper's signature.
    command = inspect.unwrap(command)
    added: dict[str, Any] = {"json": (JsonFlag, False), "quiet": (QuietFlag, False)}
    if scenes:
        added["allow_outside"] = (AllowOutside, False)
    if plugins:
        added["plugin"] = (PluginFiles, ())
    parameters = [
        *inspect.signature(function).parameters.values(),
        *(
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=usual, annotation=kind)
            for name, (kind, usual) in added.items()
        ),
    ]
    # tyro reads these; functools.wraps would make it read the inner function's, without the flags.
    command.__name__, command.__doc__ = function.__name__, function.__doc__
    kinds = {name: kind for name, (kind, _) in added.items()}
    command.__annotations__ = get_type_hints(function, include_extras=True) | kinds
    command.__signature__ = inspect.Signature(parameters)
    return command


def with_plugins_loaded(arguments: list[str]) -> list[str]:
    """Load the files that follow `--plugin`.

    It comes before parsing: a plug-in's method is a subcommand of its own.

    Args:
        arguments: The command line.
    Returns: What remains of it.
    Raises: UsageError for a file that cannot be used.
    """
    rest, files = list[str](), list[str]()
    for argument in arguments:
        if rest and rest[-1] == "--plugin":
            rest.pop()
            files.append(argument)
        elif argument.startswith("--plugin="):
            files.append(argument.removeprefix("--plugin="))
        else:
            rest.append(argument)
    if files:
        from splatproof.api.plugins import use_plugin  # brings torch

        for file in files:
            use_plugin(file)
    return rest


def and_plugins() -> str:
    """What a printed command needs to know the loaded plug-in files: " --plugin my_method.py", or nothing."""
    paths = (file.path for file in plugin_files())
    here = Path.cwd()
    near = (path.relative_to(here) if path.is_relative_to(here) else path for path in paths)
    return "".join(f" --plugin {shlex.quote(str(path))}" for path in near)
