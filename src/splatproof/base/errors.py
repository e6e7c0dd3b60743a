"""Errors that a user can cause and mend. Each message is one line: what, found, expected, what to do."""

import re

LONGEST = 2000
"""Characters of a message. Values from files go into it as they are, and a file may hold any."""
END = 500
"""Characters of it that are kept from its end, which says what to do; the beginning names the file."""

CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
"""What ends a line or moves a console's cursor; names in files may have it."""

USER = re.compile(r"(?<=://)[^/\s]*@")
"""User name and password in an address."""


def without_passwords(text: str) -> str:
    """A text whose addresses name no user and no password.

    >>> without_passwords("http://me:secret@host:5000/p does not answer")
    'http://host:5000/p does not answer'
    """
    return USER.sub("", text)


class SplatproofError(Exception):
    """Base of every error that is told to the user in one line, without a traceback."""

    exit_code = 1

    def __str__(self) -> str:
        """The message on one line, without passwords; one longer than LONGEST without its middle."""
        told = without_passwords(super().__str__())
        text = CONTROL.sub(lambda found: ascii(found[0])[1:-1], told)
        if len(text) <= LONGEST:
            return text
        left_out = f" ... ({len(text) - LONGEST} characters left out) ... "
        return text[: LONGEST - END] + left_out + text[-END:]


class DataError(SplatproofError):
    """A file, folder or array that was handed in is not what it must be."""

    exit_code = 2


class UsageError(SplatproofError):
    """A name, setting or argument that does not exist or does not fit."""

    exit_code = 2


class MissingError(SplatproofError):
    """This machine lacks something: a package, a device, weights, disk or memory."""

    exit_code = 3
