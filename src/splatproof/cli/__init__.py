"""The `bench` command: one module a command, joined here by tyro.

A command is a plain typed function in splatproof.cli.<command>; its docstring's Args are the help, what
it returns (an int, or None for 0) is the exit code, and it prints through splatproof.cli.output. It is
imported only when it is chosen, and imports what is heavy (torch, mlflow, pycolmap) when it is called.
"""

import gc
import importlib
import inspect
import io
import os
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from difflib import get_close_matches

from tyro.extras import SubcommandApp

from splatproof.base.errors import UsageError
from splatproof.base.idle_threads import wait_asleep
from splatproof.cli import flags
from splatproof.cli.ending import ended

DESCRIPTION = """A test-first evaluation and benchmark harness for large-scale Gaussian splatting.

Results go to stdout, logs and progress to stderr. Exit codes: 0 done, 1 a case failed or regressed,
2 usage or bad input, 3 this machine lacks something. `bench --version` says which release and commit
this is, `bench doctor` all that a report of a fault needs."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """One subcommand: where its function lives, and the line that `bench --help` shows."""

    module: str
    """Module of splatproof.cli."""
    functions: dict[str, str]
    """Subcommand name to function name; "" for a command without subcommands. Empty: the module's
    function subcommands() returns subcommand name to function (they depend on a registry)."""
    help: str
    plugins: bool = False
    """Whether it takes `--plugin`: it looks up methods, metrics or kinds of scene folders by name."""
    scenes: bool = False
    """Whether it takes `--allow-outside`: it opens scenes that users name."""


COMMANDS = {
    "ingest": Command(
        module="ingest",
        functions={"": "ingest"},
        help="Turn a folder of photos into a scene by structure from motion.",
    ),
    "scenes": Command(
        module="scenes",
        functions={"list": "list_scenes", "show": "show", "get": "get", "make": "make"},
        help="List, show, download or make the registered scenes.",
        plugins=True,
    ),
    "fit": Command(
        module="fit",
        functions={},
        help="Train one method on one scene and score the held-out views.",
        plugins=True,
        scenes=True,
    ),
    "render": Command(
        module="render",
        functions={"": "render"},
        help="Render a trained model's views as images.",
        plugins=True,
        scenes=True,
    ),
    "view": Command(
        module="view",
        functions={"": "view"},
        help="Look at trained models in the browser, from anywhere.",
        plugins=True,
        scenes=True,
    ),
    "turntable": Command(
        module="turntable",
        functions={"": "turntable"},
        help="Write a film of a trained model: round the scene, or along its cameras.",
        plugins=True,
        scenes=True,
    ),
    "score": Command(
        module="score",
        functions={"": "score"},
        help="Score a folder of renders, made by anything, against a folder of truths.",
        plugins=True,
        scenes=True,
    ),
    "export": Command(
        module="export",
        functions={"": "export"},
        help="Write a trained model as a .ply file.",
        plugins=True,
        scenes=True,
    ),
    "run": Command(
        module="run",
        functions={"": "run"},
        help="Run a suite: every scene x method x protocol x seed, resumable at any moment.",
        plugins=True,
        scenes=True,
    ),
    "frames": Command(
        module="frames",
        functions={"": "frames"},
        help="Time a frame of a suite's saved models, drawn in turns.",
        plugins=True,
        scenes=True,
    ),
    "protocols": Command(
        module="protocols",
        functions={"": "protocols"},
        help="List and explain the rules by which views are held out and scored.",
        plugins=True,
    ),
    "study": Command(
        module="study",
        functions={},
        help="Measure what no trained case answers: stability, speed, partitions, file sizes, memory.",
    ),
    "train-prior": Command(
        module="train_prior",
        functions={
            "depth": "depth",
            "completion": "completion",
            "refiner": "refiner",
            "matcher": "matcher",
        },
        help="Train the networks that make priors, on worlds that no suite tests.",
    ),
    "plan": Command(
        module="plan",
        functions={"": "plan"},
        help="Plan a city: blocks, memory and wall time on n machines, where it stops scaling.",
        plugins=True,
        scenes=True,
    ),
    "report": Command(
        module="report",
        functions={"": "report"},
        help="Print the leaderboard and write the report page from the tracking store.",
        plugins=True,
    ),
    "dashboard": Command(
        module="dashboard",
        functions={"": "dashboard"},
        help="Show leaderboards, histories, claims, plots and pictures of a store in the browser.",
        plugins=True,
    ),
    "compare": Command(
        module="compare",
        functions={"": "compare"},
        help="Say what got better, worse or stayed equal between two sets of results.",
        plugins=True,
    ),
    "baseline": Command(
        module="baseline",
        functions={"save": "save", "list": "list_saved", "bands": "bands"},
        help="Freeze results in a file, list such files, measure the noise of metrics.",
    ),
    "published": Command(
        module="published",
        functions={"": "published"},
        help="Show what the papers print beside our records, and whether they compare.",
    ),
    "claims": Command(
        module="claims",
        functions={"": "claims"},
        help="Judge what the papers and this project claim, by committed rows or by your runs.",
    ),
    "gallery": Command(
        module="gallery",
        functions={"": "gallery"},
        help="Draw one picture a component, from the code itself.",
    ),
    "doctor": Command(
        module="doctor",
        functions={"": "doctor"},
        help="Say what this machine has, what is missing and how to get it.",
    ),
}


def main(args: Sequence[str] | None = None) -> int:
    """Run `bench` with these arguments (default: the process's) and return the exit code."""
    arguments = list(sys.argv[1:] if args is None else args)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names and consoles may have any encoding
            stream.reconfigure(errors="backslashreplace")
    wait_asleep()
    try:
        return ended(lambda: _run(arguments))
    except BrokenPipeError:
        # Whoever read our output has left (`bench ... | head`); nobody is there to be told.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _run(arguments: list[str]) -> int:
    """Parse with the chosen command loaded and the others as one-line stubs, and run it."""
    if arguments == ["--version"]:
        print(_version())
        return 0
    command = next((COMMANDS[name] for name in arguments if name in COMMANDS), None)
    if command is not None and command.plugins:
        arguments = flags.with_plugins_loaded(arguments)
    chosen, below = ([a for a in arguments if not a.startswith("-")] + ["", ""])[:2]
    app = SubcommandApp()
    for name, command in COMMANDS.items():
        if name == chosen:
            _join(app, name, command, below)
        else:
            app.command(name=name, help=command.help)(_unchosen)
    if not arguments:  # no usage error says as much as the help
        with redirect_stdout(sys.stderr), suppress(SystemExit):
            app.cli(prog="bench", description=DESCRIPTION, args=["--help"])
        return UsageError.exit_code
    if not gc.isenabled():  # so splatproof.start left it; what is loaded by now stays loaded
        gc.freeze()
        gc.enable()
    code = app.cli(prog="bench", description=DESCRIPTION, args=arguments)
    return 0 if code is None else int(code)


def _version() -> str:
    """Release, and the commit of the checkout that runs where it is one."""
    from splatproof import __version__
    from splatproof.suites.environment import git_commit

    commit = git_commit()
    return f"splatproof {__version__}" + (f", commit {commit}" if commit else "")


def _unchosen() -> int:
    raise AssertionError("only the chosen command runs")


def _join(app: SubcommandApp, name: str, command: Command, below: str) -> None:
    """Import the command's module and add its function, or a group of them, to the app.

    Help shows the whole docstring of the command that is chosen (`below`, in a group) and the first
    line of its neighbours.
    """
    module = importlib.import_module(f"splatproof.cli.{command.module}")
    named = {key: getattr(module, f) for key, f in command.functions.items()}
    given = named or module.subcommands()
    functions = {
        key: flags.with_flags(f, plugins=command.plugins, scenes=command.scenes)
        for key, f in given.items()
    }
    if "" in functions:
        app.command(name=name)(functions[""])
        return
    if below and below not in functions and (near := get_close_matches(below, functions, n=1)):
        raise UsageError(f"bench {name}: unknown {below!r}, did you mean {near[0]!r}?")
    group = SubcommandApp()
    for key, function in functions.items():
        first = inspect.cleandoc(function.__doc__ or "").splitlines()[0]
        group.command(name=key, help=None if key == below else first)(function)
    app.command(group, name=name, help=command.help)
