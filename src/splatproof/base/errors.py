"""Errors that a user can cause and mend. Each message is one line: what, found, expected, what to do."""


class SplatproofError(Exception):
    """Base of every error that is told to the user in one line, without a traceback."""

    exit_code = 1


class DataError(SplatproofError):
    """A file, folder or array that was handed in is not what it must be."""

    exit_code = 2


class UsageError(SplatproofError):
    """A name, setting or argument that does not exist or does not fit."""

    exit_code = 2


class MissingError(SplatproofError):
    """This machine lacks something: a package, a device, weights, disk or memory."""

    exit_code = 3
