"""Pages that a command serves on this machine, to this machine alone."""

import socket
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from splatproof.base.errors import UsageError

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

HOST = "127.0.0.1"
MOST_PORT = 65535


def headers(policy: str) -> dict[str, str]:
    """Headers that every answer has: nothing of it is for pages from elsewhere.

    Args:
        policy: Content-Security-Policy of the page.
    """
    return {
        "Content-Security-Policy": f"{policy}; frame-ancestors 'none'",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
    }


def listening(port: int) -> socket.socket:
    """A socket that this machine alone can reach.

    Args:
        port: Its port; 0: any that is free.
    Raises: UsageError for a number that is no port, or where another program has it.
    """
    if not 0 <= port <= MOST_PORT:
        raise UsageError(f"--port {port}: expected 0 to {MOST_PORT}")
    try:
        at = socket.create_server((HOST, port))
    except OSError as error:
        raise UsageError(
            f"--port {port}: {error.strerror}; choose another, or 0 for any that is free"
        ) from error
    # connections inherit it. Without it the body of an answer waits 40 ms for the browser to acknowledge
    # the headers: asyncio sees to that only for sockets that were made with a protocol number.
    at.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return at


def refusal(
    request: "Request", port: int, said: Mapping[str, str], *, entry: bool
) -> "Response | None":
    """What a request gets that this machine's own page did not make; None: it may be answered.

    Requests by another name than this machine's are refused, since a page from elsewhere could make
    its own name point here (DNS rebinding); so are requests that a page from elsewhere makes.

    Args:
        request: What was asked.
        port: Port that is served.
        said: Headers of the answer.
        entry: Whether it asks for the page itself, to which links from elsewhere may lead.
    """
    from starlette.responses import PlainTextResponse

    names = {f"{name}:{port}" for name in (HOST, "localhost", "[::1]")}
    if request.headers.get("host", "") not in names:
        return PlainTextResponse(f"this is {HOST}:{port}\n", 421, said)
    if request.headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and not entry:
        return PlainTextResponse("for its own page alone\n", 403, said)
    return None


def server_of(application: "Starlette") -> Any:
    """A uvicorn server that has not started yet.

    Args:
        application: What answers.
    """
    import uvicorn

    return uvicorn.Server(
        uvicorn.Config(
            application,
            log_level="warning",
            access_log=False,
            lifespan="off",
            ws="none",
            server_header=False,
        )
    )
