"""What the workers of tests/base/test_processes.py do; a new process imports it by this name."""

import os
from multiprocessing.connection import Connection

from splatproof.base.inside import outside_is_allowed
from splatproof.base.quiet import is_quiet


def echo(says: Connection, greeting: str) -> None:
    """Say the greeting, then whatever is heard, until that is "end"."""
    says.send(greeting)
    while (heard := says.recv()) != "end":
        says.send(heard)


def die(says: Connection, code: int) -> None:
    """End without a word: with an exit code, or by a signal where it is negative."""
    del says
    if code < 0:
        os.kill(os.getpid(), -code)
    os._exit(code)


def tell_quiet(says: Connection) -> None:
    """Say whether logs and progress are silenced here."""
    says.send(is_quiet())


def tell_variable(says: Connection, name: str) -> None:
    """Say a variable of the environment."""
    says.send(os.environ.get(name))


def tell_trust(says: Connection) -> None:
    """Say whether scene files may name files outside their folder."""
    says.send(outside_is_allowed())
