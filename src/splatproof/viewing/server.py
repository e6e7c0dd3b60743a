"""The viewer served on this machine, to this machine alone: a page, its state, pictures.

Pictures are plain answers to plain requests. A page asks for the next when one has come, so nothing
queues up, and no second protocol is needed: on this machine a request costs well under a millisecond
beside the tens that drawing takes (`bench view --measure` shows both).
"""

import asyncio
import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatproof.base import local_server
from splatproof.base.errors import SplatproofError, UsageError
from splatproof.reports.dashboard import assets
from splatproof.viewing.asked import read_asked, whole
from splatproof.viewing.frames import Wishes, frame_of, photo_jpeg
from splatproof.viewing.stage import Stage
from splatproof.viewing.state import state_of

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

STATIC = Path(__file__).parent / "static"
SCRIPTS = ("camera", "overlay", "frames", "beside", "controls", "panel", "start")
"""The viewer's scripts in the order in which they are loaded."""
SHARED = ("core.js", "theme.js", "style.css")
"""Files of the dashboard that this page has too."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'"
)
"""Content-Security-Policy: nothing from elsewhere, and no script or style but files."""
HEADERS = local_server.headers(POLICY)
PHOTO_WIDTH = 1280
"""Most pixels across a photo on the page."""
TYPES = {".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}
Answer = tuple[bytes, str, dict[str, str]]
"""Bytes, media type, further headers."""


class Site:
    """Every path of the viewer and what stands there."""

    def __init__(self, stage: Stage) -> None:
        """Show a stage.

        Args:
            stage: Its models may be replaced meanwhile.
        """
        self._stage, self._wishes = stage, Wishes()

    def expect(self, path: str, told: Mapping[str, str]) -> None:
        """Hear of a request before its turn comes, so that older ones of its page are dropped.

        Args:
            path: As for `read`.
            told: As for `read`.
        Raises: UsageError for a turn that is no number.
        """
        if path == "frame":
            self._wishes.add(*_wish(told))

    def read(self, path: str, told: Mapping[str, str]) -> Answer | None:
        """What stands at a path; None: nothing.

        Args:
            path: Below the page's address, without a slash at its start.
            told: The query.
        Raises: UsageError for a query that asks for what is not there.
        """
        match path.split("/"):
            case [""]:
                return page().encode(), "text/html; charset=utf-8", {}
            case ["app", name]:
                return _app_file(name)
            case ["state.json"]:
                text = json.dumps(state_of(self._stage), allow_nan=False)
                return text.encode(), "application/json", {}
            case ["photo", number] if number.isascii() and number.isdecimal():
                jpeg = photo_jpeg(self._stage, int(number[:9]), PHOTO_WIDTH)
                return jpeg, "image/jpeg", {}
            case ["frame"]:
                return self._frame(told)
        return None

    def _frame(self, told: Mapping[str, str]) -> Answer:
        if self._wishes.is_old(*_wish(told)):
            return b"", "", {}
        frame = frame_of(self._stage, read_asked(self._stage, told))
        facts: dict[str, Any] = {
            "told": frame.told, "render_ms": round(frame.render_ms, 2),
            "encode_ms": round(frame.encode_ms, 2),
            "steps": [one.step for one in self._stage.models],
        }  # fmt: skip
        return frame.jpeg, "image/jpeg", {"X-Frame": json.dumps(facts)}  # ASCII: json escapes names


def _wish(told: Mapping[str, str]) -> tuple[str, int]:
    return told.get("page", "")[:64], whole(told, "turn", 0, 2**53, 0)


def page() -> str:
    """The HTML document."""
    names = [name for name in SHARED if name.endswith(".js")] + [f"{name}.js" for name in SCRIPTS]
    tags = "\n".join(f'<script src="app/{name}"></script>' for name in names)
    text = (STATIC / "index.html").read_text("utf-8")
    return text.replace("POLICY", POLICY).replace("SCRIPTS", tags)


def _app_file(name: str) -> Answer | None:
    if name in SHARED:
        content = assets.app_file(name)
    else:
        known = {"view.css", *(f"{script}.js" for script in SCRIPTS)}
        content = (STATIC / name).read_bytes() if name in known else None
    return None if content is None else (content, TYPES[Path(name).suffix], {})


def application(stage: Stage, port: int) -> "Starlette":
    """The server's program: it answers GET requests of this machine's own page.

    One thread of its own draws and reads everything, one request after the other: the rasterizer takes
    all cores by itself, and each further change of threads costs milliseconds on a busy machine.

    Args:
        stage: What is shown.
        port: Port that it is served at.
    """
    from starlette.applications import Starlette
    from starlette.responses import PlainTextResponse, Response
    from starlette.routing import Route

    site, one = Site(stage), ThreadPoolExecutor(1, thread_name_prefix="viewer")

    async def answer(request: "Request") -> "Response":
        path, told = request.path_params["path"], dict(request.query_params)
        refused = local_server.refusal(request, port, HEADERS, entry=not path)
        if refused is not None:
            return refused
        try:
            site.expect(path, told)
            found = await asyncio.wrap_future(one.submit(site.read, path, told))
        except UsageError as error:
            return PlainTextResponse(f"{error}\n", 400, HEADERS)
        except SplatproofError as error:
            return PlainTextResponse(f"{error}\n", 500, HEADERS)
        if found is None:
            return PlainTextResponse("nothing is here\n", 404, HEADERS)
        content, kind, more = found
        said = HEADERS | {"Cache-Control": "no-store"} | more
        return Response(content, 200 if content else 204, said, kind or None)

    return Starlette(routes=[Route("/{path:path}", answer, methods=["GET"])])
