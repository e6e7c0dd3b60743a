"""The dashboard served on this machine, to this machine alone."""

import socket
from typing import TYPE_CHECKING, Any

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.reports.dashboard.assets import POLICY
from splatproof.reports.dashboard.site import Site

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

HOST = "127.0.0.1"
HEADERS = {
    "Content-Security-Policy": f"{POLICY}; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Data comes as scripts, which any page could include: browsers refuse that by the resource policy."""
LASTING = ("picture/", "thumb/", "app/")
"""Starts of paths whose files do not change while the server lives."""


def listening(port: int) -> socket.socket:
    """A socket that this machine alone can reach.

    Args:
        port: Its port; 0: any that is free.
    Raises: UsageError where another program has the port.
    """
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise UsageError(
            f"--port {port}: {error.strerror}; choose another, or 0 for any that is free"
        ) from error


def application(site: Site, port: int) -> "Starlette":
    """The server's program: it answers GET requests for the site's paths.

    Requests by another name than this machine's are refused, since a page from elsewhere could make its
    own name point here (DNS rebinding); so are requests that a page from elsewhere makes.

    Args:
        site: What is shown.
        port: Port that it is served at.
    """
    from starlette.applications import Starlette
    from starlette.responses import PlainTextResponse, Response
    from starlette.routing import Route

    names = {f"{name}:{port}" for name in (HOST, "localhost", "[::1]")}

    def answer(request: "Request") -> "Response":
        path = request.path_params["path"]
        if request.headers.get("host", "") not in names:
            return PlainTextResponse(f"this is {HOST}:{port}\n", 421, HEADERS)
        asked_from = request.headers.get("sec-fetch-site", "none")
        if asked_from not in ("none", "same-origin") and path:
            return PlainTextResponse("for its own page alone\n", 403, HEADERS)
        try:
            found = site.read(path)
        except SplatproofError as error:
            return PlainTextResponse(f"{error}\n", 500, HEADERS)
        if found is None:
            return PlainTextResponse("nothing is here\n", 404, HEADERS)
        kept = "private, max-age=3600" if path.startswith(LASTING) else "no-store"
        return Response(found[0], 200, HEADERS | {"Cache-Control": kept}, found[1])

    return Starlette(routes=[Route("/{path:path}", answer, methods=["GET"])])


def serve(site: Site, at: socket.socket) -> None:
    """Serve until ctrl-C.

    Args:
        site: What is shown.
        at: Where: a socket of `listening`.
    """
    server_of(site, at).run(sockets=[at])


def server_of(site: Site, at: socket.socket) -> Any:
    """A uvicorn server that has not started yet.

    Args:
        site: What is shown.
        at: Where it will listen.
    """
    import uvicorn

    return uvicorn.Server(
        uvicorn.Config(
            application(site, at.getsockname()[1]),
            log_level="warning",
            access_log=False,
            lifespan="off",
            ws="none",
            server_header=False,
        )
    )
