"""A viewer served for a test."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from splatproof.base.local_server import listening, server_of
from splatproof.viewing.server import application
from splatproof.viewing.stage import Stage


@contextmanager
def serving(stage: Stage) -> Iterator[int]:
    """The port at which a stage is shown while the block runs."""
    at = listening(0)
    server = server_of(application(stage, at.getsockname()[1]))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [at]}, daemon=True)
    thread.start()
    try:
        yield at.getsockname()[1]
    finally:
        server.should_exit = True
        thread.join(10)
