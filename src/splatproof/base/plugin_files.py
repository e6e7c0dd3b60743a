"""Python files that a user names with `--plugin`: loaded once, by content, here and in workers."""

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from splatproof.base.errors import UsageError
from splatproof.base.files import read_bytes

PREFIX = "splatproof_plugin_"
"""What a file's module is called: this and the file's name without its suffix."""


@dataclass(frozen=True, kw_only=True)
class PluginFile:
    """A file whose objects stand beside what is built in."""

    path: Path
    """Absolute path."""
    sha256: str
    """Hash of the bytes that were run, in hexadecimal."""

    @property
    def name(self) -> str:
        """What records call the file."""
        return self.path.name

    @property
    def module(self) -> ModuleType:
        """The module that the file became."""
        return sys.modules[PREFIX + self.path.stem]


_loaded: dict[str, PluginFile] = {}
"""Files by the names of their modules, in the order in which they were loaded."""


def plugin_files() -> tuple[PluginFile, ...]:
    """The files that this process has loaded, the first one first."""
    return tuple(_loaded.values())


def load_plugin_file(path: str | Path, *, expected: str = "") -> PluginFile:
    """Run a Python file as a module that pickle finds again, and remember it.

    A file that is loaded already is not run again unless its content has changed.

    Args:
        path: The file; its name without the suffix must be a Python identifier.
        expected: Hash that the content must have, where another process loaded it first; empty: any.

    Raises: UsageError, naming the file, if it is missing, cannot be run, has changed since
        another process loaded it, or has the name of another file that is loaded.
    """
    file = Path(path).resolve()
    if file.suffix != ".py" or not file.stem.isidentifier():
        raise UsageError(
            f"plugin {path}: expected a Python file with a name of letters, digits and '_', such as "
            "my_method.py"
        )
    source = read_bytes(file, UsageError)
    found = PluginFile(path=file, sha256=hashlib.sha256(source).hexdigest())
    if expected and found.sha256 != expected:
        raise UsageError(f"plugin {path}: changed while it was at work; run the command again")
    name = PREFIX + file.stem
    before = _loaded.get(name)
    if before is not None and before == found:
        return before
    if before is not None and before.path != file:
        raise UsageError(f"plugin {path}: {before.path} has the same name; rename one of the two")
    _run(file, source, name)
    _loaded[name] = found
    return found


def forget_plugin_file(file: PluginFile) -> None:
    """Have a file count as never loaded: what is refused must not stand in the way of what follows.

    Args:
        file: A file that is loaded.
    """
    del _loaded[PREFIX + file.path.stem], sys.modules[PREFIX + file.path.stem]


def _run(file: Path, source: bytes, name: str) -> None:
    """Run the source as the module of that name; one that fails leaves what was there before."""
    module, before = ModuleType(name), sys.modules.get(name)
    module.__file__ = str(file)
    sys.modules[name] = module  # dataclasses and pickle look their module up by its name
    try:
        exec(compile(source, str(file), "exec"), module.__dict__)  # noqa: S102 (what the user named)
    except Exception as error:
        if before is None:
            del sys.modules[name]
        else:
            sys.modules[name] = before
        where = _line(error, file)
        raise UsageError(f"plugin {file}{where}: cannot be loaded ({error!r}); mend it") from error


def _line(error: Exception, file: Path) -> str:
    """ ":12" where the error came from line 12 of the file; the line of the file alone helps."""
    if isinstance(error, SyntaxError):
        return f":{error.lineno}"
    line, frame = "", error.__traceback__
    while frame is not None:
        if frame.tb_frame.f_code.co_filename == str(file):
            line = f":{frame.tb_lineno}"
        frame = frame.tb_next
    return line


class Brought:
    """The loaded files on their way to another process, where unpickling this loads them.

    It must be pickled before what is made of their classes.
    """

    def __init__(self, files: Sequence[PluginFile] | None = None) -> None:
        """Take files along.

        Args:
            files: Which; None: all that this process has loaded.
        """
        self.files = plugin_files() if files is None else tuple(files)

    def __reduce__(self) -> tuple[object, ...]:
        """How pickle makes it again: by loading the files."""
        return _bring, (tuple((str(file.path), file.sha256) for file in self.files),)


def _bring(files: Sequence[tuple[str, str]]) -> Brought:
    return Brought([load_plugin_file(path, expected=sha256) for path, sha256 in files])
