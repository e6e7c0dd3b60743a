"""The dashboard as files: every path and what stands there, whether a server or a folder shows them."""

import json
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import PurePosixPath
from typing import Any

from splatproof import __version__
from splatproof.base.errors import MissingError
from splatproof.reference.types.result import picture_name
from splatproof.reports.claims.claim import Claim
from splatproof.reports.comparing.cases import CaseRecord, case_record
from splatproof.reports.dashboard import assets
from splatproof.reports.dashboard.cache import Cache
from splatproof.reports.dashboard.claim_data import claims_payload
from splatproof.reports.dashboard.comparison import comparison_payload
from splatproof.reports.dashboard.history import all_series
from splatproof.reports.dashboard.history_data import history_payload
from splatproof.reports.dashboard.index import Index, Progress, refreshed, silent
from splatproof.reports.dashboard.listing import list_runs
from splatproof.reports.dashboard.numbers import plain_value, script
from splatproof.reports.dashboard.payload import images_payload, runs_payload
from splatproof.reports.dashboard.sides import Side, all_sides
from splatproof.reports.dashboard.summary import Summary
from splatproof.reports.mlflow_client import shown_uri
from splatproof.reports.pictures import to_jpeg
from splatproof.reports.store import FOLDERS, read_file, read_run

THUMB_WIDTH, THUMB_QUALITY = 128, 80
"""Pixels and JPEG quality of the small pictures in lists: twice the size that they are shown at."""
THUMBS = 4096
"""Small pictures that are kept in memory, of about 4 kB each."""
CASES = 1024
"""Records that are kept in memory for comparisons, of about 20 kB each."""
PATIENCE = 1.5
"""Seconds that a page waits for new runs to be read; then it shows what was known, and says so."""
TYPES = {
    ".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8", ".json": "application/json", ".png": "image/png",
    ".jpg": "image/jpeg",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class State:
    """The store at one moment, and what follows from it."""

    index: Index
    runs: dict[str, Summary]
    tables: dict[str, dict[str, Any]]
    sides: dict[str, Side]
    series: dict[str, list[Summary]]
    made: int
    """When it was read, in milliseconds since 1970 (UTC)."""


class Site:
    """Every file of the dashboard by its path; threads may read at once."""

    def __init__(
        self, uri: str, cache: Cache, claims: Sequence[Claim], progress: Progress = silent
    ) -> None:
        """Read the store.

        Args:
            uri: Tracking URI.
            cache: What was read before; kept up to date.
            claims: Claims that are judged by the store's runs.
            progress: Told of what takes long at the start.
        Raises: MissingError, DataError: see `index.refreshed`.
        """
        self.uri, self._cache, self._claims = uri, cache, claims
        self._lock = threading.Lock()
        self._listed = self._names()
        self.state = self._read(progress)
        self._reader = ThreadPoolExecutor(1, "reading")
        self._coming: Future[tuple[State, list[str]]] | None = None
        self._texts: dict[str, bytes] = {}
        self._thumb = lru_cache(THUMBS)(self._small)
        self._case = lru_cache(CASES)(self._read_case)

    def read(self, path: str) -> tuple[bytes, str] | None:
        """The bytes at a path and their media type; None where nothing stands there.

        The index is read from the store again where that has other runs than before.

        Args:
            path: Path below the page's address, without a slash at its start.
        Raises: MissingError, DataError: the store is gone or damaged.
        """
        path = path or "index.html"
        content = self._content(PurePosixPath(path))
        return None if content is None else (content, TYPES[PurePosixPath(path).suffix])

    def _content(self, path: PurePosixPath) -> bytes | None:
        match path.parts:
            case ("index.html",):
                return assets.page().encode()
            case ("app", name):
                return assets.app_file(name)
            case ("data", *_) if path.suffix == ".js":
                name = path.relative_to("data").with_suffix("").as_posix()
                return self._data(name)
            case ("record", _) if path.suffix == ".json":
                run = self.state.runs.get(path.stem)
                return None if run is None else read_file(run.files, self.uri, "record.json")
            case ("picture", run, kind, file) if path.suffix == ".png":
                return self.picture(run, kind, file)
            case ("thumb", run, kind, file) if path.suffix == ".jpg":
                return self._thumb(run, kind, f"{path.stem}.png")
        return None

    def picture(self, run: str, kind: str, file: str) -> bytes | None:
        """A picture as the store has it: only names of the run's own scored images lead to one.

        Args:
            run: MLflow's name of the run.
            kind: render, truth or error.
            file: File name of the picture.
        """
        summary = self.state.runs.get(run)
        if summary is None or kind not in FOLDERS:
            return None
        if file not in {picture_name(image) for image in summary.numbers.images}:
            return None
        return read_file(summary.files, self.uri, f"{FOLDERS[kind]}/{file}")

    def _small(self, run: str, kind: str, file: str) -> bytes | None:
        png = self.picture(run, kind, file)
        name = f"run {run}: {kind} {file}"
        return None if png is None else to_jpeg(png, name, THUMB_WIDTH, THUMB_QUALITY)

    def _data(self, name: str) -> bytes | None:
        with self._lock:
            if name == "index":
                self._refresh()
            if name not in self._texts:
                plain = self._plain(name)
                if plain is None:
                    return None
                text = script(name, plain).encode()
                if name not in ("index", "images", "claims"):
                    return text
                self._texts[name] = text
            return self._texts[name]

    def _plain(self, name: str) -> Any:
        """The data that the page asks for by this name."""
        state, (kind, _, rest) = self.state, name.partition("/")
        match kind, rest:
            case "index", "":
                return self.index_data("served", "png", "all", "")
            case "images", "":
                return images_payload(state.index)
            case "claims", "":
                return claims_payload(self._claims, state.index, state.sides)
            case "table", _ if rest in state.tables:
                return state.tables[rest]["full"]
            case "run", _ if rest in state.runs:
                return self._record(state.runs[rest])
            case "history", _ if rest in state.series:
                return history_payload(state.series[rest], self._case)
            case "compare", _:
                one, _, other = rest.partition("~")
                if one in state.sides and other in state.sides and one != other:
                    return comparison_payload(
                        state.sides[one], state.sides[other], state.index, self._case
                    )
        return None

    def index_data(self, mode: str, format: str, pictures: Any, left_out: str) -> dict[str, Any]:
        """What the page loads first: all runs, tables and sides.

        Args:
            mode: served or static.
            format: Ending of pictures: png or jpg.
            pictures: "all", or the places of the images that are there by run.
            left_out: What a static build does not have, in one line.
        """
        state = self.state
        site = {
            "mode": mode, "format": format, "pictures": pictures, "left_out": left_out,
            "uri": shown_uri(self.uri), "version": __version__, "made": state.made,
            "reading": self._coming is not None,
            "images": sum(len(one.numbers.images) for one in state.index.shown),
        }  # fmt: skip
        sides = [side.plain() for side in state.sides.values()]
        return {"site": site, "runs": runs_payload(state.index), "sides": sides}

    def _read_case(self, run: str) -> CaseRecord:
        """What a comparison needs of a run."""
        return case_record(read_run(self.uri, run, self.state.runs[run].files))

    def _record(self, run: Summary) -> Any:
        text = read_file(run.files, self.uri, "record.json")
        if text is None:
            raise MissingError(f"run {run.run}: its record is not at {run.files} any more")
        whole = json.loads(text)
        return plain_value({k: v for k, v in whole.items() if k not in ("curve", "images")})

    def _names(self) -> list[str]:
        return [one.run for one in list_runs(self.uri)]

    def _refresh(self) -> None:
        """Take new runs into the state; those that take long to read come with a later page."""
        if self._coming is None and self._names() != self._listed:
            self._coming = self._reader.submit(self._read_again)
        if self._coming is None:
            return
        self._texts.clear()
        try:
            self.state, self._listed = self._coming.result(PATIENCE)
        except TimeoutError:
            return
        except Exception:
            self._coming = None  # the next page tries again
            raise
        self._coming = None

    def _read_again(self) -> tuple[State, list[str]]:
        names = self._names()
        return self._read(silent), names

    def _read(self, progress: Progress) -> State:
        index = refreshed(self.uri, self._cache, progress)
        return State(
            index=index,
            runs={one.run: one for one in index.runs},
            tables={table["brief"]["id"]: table for table in index.tables},
            sides=all_sides(index),
            series=all_series(index.runs),
            made=int(1000 * time.time()),
        )
