"""A dashboard served for a test."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from splatproof.base.local_server import listening
from splatproof.reports.dashboard.server import server_of
from splatproof.reports.dashboard.site import Site


@contextmanager
def serving(site: Site) -> Iterator[int]:
    """The port at which a site is served while the block runs."""
    at = listening(0)
    server = server_of(site, at)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [at]}, daemon=True)
    thread.start()
    try:
        yield at.getsockname()[1]
    finally:
        server.should_exit = True
        thread.join(10)
