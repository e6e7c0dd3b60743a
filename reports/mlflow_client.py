"""Opening an MLflow store: quiet, off the network but for the store itself, with bounded waits."""

import logging
import os
import sys
import urllib.parse
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from sqlite3 import Connection
from typing import TYPE_CHECKING

from splatproof.base.errors import MissingError, UsageError, without_passwords
from splatproof.base.files import check_target
from splatproof.base.locks import locked

if TYPE_CHECKING:
    from mlflow.tracking import MlflowClient

ENVIRONMENT = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "DO_NOT_TRACK": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "MLFLOW_LOGGING_LEVEL": "WARNING",  # "Creating initial MLflow database tables" and the like
    # MLflow would try 7 times with waits that double, about 4 minutes for one call
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "20",
}
"""Set unless the user has set them. Two retries, 1 and 2 s apart, of at most 20 s each."""
IN_URIS = "%?#"
"""Letters that a URI takes for its own."""


def default_uri(out: Path) -> str:
    """The tracking URI: MLFLOW_TRACKING_URI where it is set, else an SQLite file in `out`.

    Args:
        out: Folder of the runs.
    Raises: UsageError where MLFLOW_TRACKING_URI names a kind of store that MLflow 3 refuses, or
        `out` cannot be named in a URI.
    """
    uri = os.environ.get("MLFLOW_TRACKING_URI") or sqlite_uri(out / "mlflow.db")
    check_uri(uri)
    return uri


def sqlite_uri(file: Path) -> str:
    """The tracking URI of an SQLite file.

    Letters that mean something in a URI are quoted. MLflow makes the folder of a "sqlite:" URI by its
    name as it is quoted, so the driver, which it would take anyway, is named then: it makes none.

    Args:
        file: The database; relative to the current folder, and it may be missing.
    Raises: UsageError for a path that is not UTF-8 text.

    >>> sqlite_uri(Path("/runs/mlflow.db")), sqlite_uri(Path("/what?/mlflow.db"))
    ('sqlite:////runs/mlflow.db', 'sqlite+pysqlite:////what%3F/mlflow.db')
    """
    path = str(file.resolve())
    try:
        path.encode()
    except UnicodeEncodeError:
        raise UsageError(
            f"{path!r}: not UTF-8, so a tracking URI cannot name it; choose another folder"
        ) from None
    quoted = "".join(f"%{ord(c):02X}" if c in IN_URIS else c for c in path)
    return f"{'sqlite' if quoted == path else 'sqlite+pysqlite'}:///{quoted}"


def check_uri(uri: str) -> None:
    """Refuse, before anything is run, a tracking URI that cannot work.

    Raises: UsageError for a plain path or a `file:` store, which MLflow 3 no longer writes, for what
        is no URI, or for an SQLite store that is no file (MLflow would try it again for minutes).
    """
    try:
        urllib.parse.urlsplit(uri)
    except ValueError as error:
        raise UsageError(f"tracking URI {uri!r}: {error}; expected http://HOST:PORT") from None
    file = sqlite_file(uri)
    if file is not None:
        check_target(file)
    if "://" not in uri or uri.startswith("file:"):
        raise UsageError(
            f"tracking URI {uri!r}: MLflow keeps no runs in plain folders any more; "
            "use sqlite:///PATH/mlflow.db or http://HOST:PORT"
        )


def shown_uri(uri: str) -> str:
    """The URI without user name and password, for messages and pages."""
    return without_passwords(uri)


def sqlite_file(uri: str) -> Path | None:
    """The database file of an SQLite URI; None for every other store."""
    scheme, _, rest = uri.partition(":///")
    if scheme.split("+")[0] != "sqlite":
        return None
    return Path(urllib.parse.unquote(rest.partition("?")[0]))  # as sqlalchemy reads it


def artifact_root(uri: str) -> str | None:
    """Where a new experiment's artifacts go: beside an SQLite file; None: the server decides."""
    file = sqlite_file(uri)
    return None if file is None else (file.resolve().parent / "mlartifacts").as_uri()


def store_errors() -> tuple[type[Exception], ...]:
    """What a store's calls raise when the store or its artifacts cannot be read or written."""
    _prepare()
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    return (MlflowException, SQLAlchemyError, OSError)


def open_client(uri: str) -> "MlflowClient":
    """A client of a store that has just answered.

    Raises:
        UsageError: The URI is of a kind that cannot work.
        MissingError: The store does not answer within the bounded retries, or lacks its driver.
    """
    check_uri(uri)
    errors: tuple[type[Exception], ...] = (*store_errors(), ImportError)
    file = sqlite_file(uri)
    with warnings.catch_warnings():
        # sqlalchemy 2.1 on MLflow's own models, raised while its module is imported
        warnings.filterwarnings("ignore", "The ``noload`` loader strategy")
        from mlflow.tracking import MlflowClient

        try:
            if file is not None and not file.exists():
                _make_tables(file)
            client = MlflowClient(uri)
            client.search_experiments(max_results=1)
        except errors as error:
            raise MissingError(
                f"tracking store {shown_uri(uri)} does not answer: {one_line(error)}; "
                "start it or set MLFLOW_TRACKING_URI, the records on disk are kept"
            ) from error
    return client


def write_tag(write: Callable[[str, str], object], name: str, value: str) -> None:
    """Write a tag that another process may write at the same time.

    Two that write a tag for the first time collide in the database. The later one finds it there when
    it tries again, and any other fault is met again.

    Args:
        write: Given name and value, makes the client write it.
        name: The tag.
        value: Its text.
    """
    try:
        write(name, value)
    except store_errors():
        write(name, value)


def _make_tables(file: Path) -> None:
    """Make an SQLite store that is there whole or not at all.

    MLflow makes its tables in dozens of steps and can neither go on after a kill between two of them
    nor begin again, so they are made under another name.
    """
    from mlflow.tracking import MlflowClient

    making = file.with_name(f"{file.name}.making")
    with locked(file.with_name(f"{file.name}.lock")):
        if file.exists():
            return  # another process has made it meanwhile
        for left in (making, making.with_name(f"{making.name}-journal")):
            left.unlink(missing_ok=True)
        try:
            with _unsynced():
                MlflowClient(sqlite_uri(making)).search_experiments(max_results=1)
            with making.open("rb+") as made:
                os.fsync(made.fileno())
            making.replace(file)
        finally:
            making.unlink(missing_ok=True)


@contextmanager
def _unsynced() -> Iterator[None]:
    """Let SQLite leave it to the system when what is written reaches the disk.

    The dozens of steps that make a store wait for the disk after each, several seconds in all, and what is
    half made is thrown away after a crash in any case.
    """
    from sqlalchemy import Engine, event

    def connected(connection: Connection, _record: object) -> None:
        connection.execute("PRAGMA synchronous = OFF")

    event.listen(Engine, "connect", connected)
    try:
        yield
    finally:
        event.remove(Engine, "connect", connected)


def _prepare() -> None:
    """Settle what MLflow reads when it is first imported, and its loudness if it was before."""
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    if "mlflow" in sys.modules:
        logging.getLogger("mlflow").setLevel(os.environ["MLFLOW_LOGGING_LEVEL"])


def one_line(error: BaseException) -> str:
    """The first line of an error's text, at most 200 characters; its type where it has none.

    Passwords in addresses are left out: MLflow's own errors quote the whole of them.
    """
    lines = without_passwords(str(error)).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__
