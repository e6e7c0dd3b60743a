"""What was once read of a store, in a file beside it: a refresh reads new runs alone."""

import json
import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

from splatproof.base.errors import MissingError

FORMAT = "1"
"""Changes whenever what is kept or how it is computed does; a cache of another format is made anew."""
TABLES = """
CREATE TABLE IF NOT EXISTS format (name TEXT);
CREATE TABLE IF NOT EXISTS runs (run TEXT PRIMARY KEY, plain TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS derived (name TEXT PRIMARY KEY, made_of TEXT NOT NULL, plain TEXT NOT NULL);
"""
BUSY = 30.0
"""Seconds that a second dashboard on the same store is waited for."""


class Cache:
    """Summaries of runs by their names, and what was derived from sets of runs.

    A finished run never changes, so what is kept of it stays right; what is derived of several is kept
    with a hash of all that it was made of.
    """

    def __init__(self, path: Path | None) -> None:
        """Open the cache, or make it; a damaged one, or one of another format, is made anew.

        Args:
            path: The cache's file; None: kept in memory for as long as this object lives.
        Raises: MissingError where the file cannot be written.
        """
        self.path = path
        try:
            self._connection = self._open()
        except sqlite3.DatabaseError:
            if path is None or not path.is_file():
                raise self._unusable() from None
            path.unlink()
            try:
                self._connection = self._open()
            except sqlite3.DatabaseError:
                raise self._unusable() from None

    def _unusable(self) -> MissingError:
        return MissingError(
            f"{self.path}: the dashboard's cache cannot be made there; give another file with --cache"
        )

    def _open(self) -> sqlite3.Connection:
        where = ":memory:" if self.path is None else str(self.path)
        connection = sqlite3.connect(where, timeout=BUSY, check_same_thread=False)
        try:
            connection.executescript(TABLES)
            formats = [name for (name,) in connection.execute("SELECT name FROM format")]
            if formats != [FORMAT]:
                with connection:
                    for table in ("runs", "derived", "format"):
                        connection.execute(f"DELETE FROM {table}")
                    connection.execute("INSERT INTO format VALUES (?)", (FORMAT,))
        except sqlite3.DatabaseError:
            connection.close()
            raise
        return connection

    def close(self) -> None:
        """Release the file."""
        self._connection.close()

    def runs(self) -> dict[str, str]:
        """JSON of every run that is kept, by its name."""
        with closing(self._connection.execute("SELECT run, plain FROM runs")) as rows:
            return dict(rows)

    def keep_runs(self, kept: Iterable[tuple[str, Any]]) -> None:
        """Keep plain data of runs by their names.

        Args:
            kept: Pairs of a run's name and its plain data.
        """
        rows = [(run, json.dumps(plain, separators=(",", ":"))) for run, plain in kept]
        with self._connection:
            self._connection.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?)", rows)

    def derived(self, name: str, made_of: str) -> Any:
        """What was derived under this name of exactly this; None where it was not.

        Args:
            name: What it is.
            made_of: Hash of all that it depends on.
        """
        query = "SELECT plain FROM derived WHERE name = ? AND made_of = ?"
        found = self._connection.execute(query, (name, made_of)).fetchone()
        return json.loads(found[0]) if found else None

    def keep_derived(self, name: str, made_of: str, plain: Any) -> None:
        """Keep something derived in place of what was kept under its name.

        Args:
            name: What it is.
            made_of: Hash of all that it depends on.
            plain: The plain data.
        """
        row = (name, made_of, json.dumps(plain, separators=(",", ":")))
        with self._connection:
            self._connection.execute("INSERT OR REPLACE INTO derived VALUES (?, ?, ?)", row)
