"""The dashboard served on this machine, to this machine alone."""

import socket
from typing import TYPE_CHECKING, Any

from splatproof.base import local_server
from splatproof.base.errors import SplatproofError
from splatproof.reports.dashboard.assets import POLICY
from splatproof.reports.dashboard.site import Site

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

HEADERS = local_server.headers(POLICY)
"""Data comes as scripts, which any page could include: browsers refuse that by the resource policy."""
LASTING = ("picture/", "thumb/", "app/")
"""Starts of paths whose files do not change while the server lives."""


def application(site: Site, port: int) -> "Starlette":
    """The server's program: it answers GET requests of this machine for the site's paths.

    Args:
        site: What is shown.
        port: Port that it is served at.
    """
    from starlette.applications import Starlette
    from starlette.responses import PlainTextResponse, Response
    from starlette.routing import Route

    def answer(request: "Request") -> "Response":
        path = request.path_params["path"]
        refused = local_server.refusal(request, port, HEADERS, entry=not path)
        if refused is not None:
            return refused
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
        at: Where: a socket of `base.local_server.listening`.
    """
    server_of(site, at).run(sockets=[at])


def server_of(site: Site, at: socket.socket) -> Any:
    """A uvicorn server that has not started yet.

    Args:
        site: What is shown.
        at: Where it will listen.
    """
    return local_server.server_of(application(site, at.getsockname()[1]))
