"""A web server on this machine that gives one file and misbehaves on request."""

import http.server
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Server(http.server.ThreadingHTTPServer):
    """Serves `body`; `ranges`, `cut` and the like say how it behaves, `asked` what it was asked."""

    def __init__(self, body: bytes):
        super().__init__(("127.0.0.1", 0), Handler)
        self.body = body
        self.ranges = True
        self.wrong_range = False
        self.status = 200
        self.moved = ""
        self.cut: list[int] = []
        self.asked: list[str | None] = []
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_address[1]}/scene.zip"


class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        server = self.server
        assert isinstance(server, Server)
        wanted = self.headers.get("Range")
        server.asked.append(wanted)
        if server.moved:
            self.send_response(302)
            self.send_header("Location", server.moved)
            self.send_header("Content-Length", "0")
            self.end_headers()
            server.moved = ""
            return
        if server.status != 200:
            self.send_error(server.status)
            return
        start = int(wanted[6:-1]) if wanted and server.ranges else 0
        if start >= len(server.body):
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{len(server.body)}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        body = server.body[start:]
        self.send_response(206 if start else 200)
        if start:
            told = start + 7 if server.wrong_range else start
            self.send_header(
                "Content-Range", f"bytes {told}-{len(server.body) - 1}/{len(server.body)}"
            )
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if server.cut:
            body = body[: server.cut.pop(0)]
        self.wfile.write(body)

    def log_message(self, format, *args):
        pass


@contextmanager
def served(body: bytes) -> Iterator[Server]:
    """A server of `body` while the block runs."""
    server = Server(body)
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
