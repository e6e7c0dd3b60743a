"""Names that do not exist: the nearest one, and all there are, in one wording."""

from collections.abc import Iterable
from difflib import get_close_matches

from splatproof.base.errors import UsageError

LISTED = 60
"""Up to this many names are listed; of more, a user is told their number."""
ALIKE = 0.5
"""Likeness (difflib's ratio, 0 to 1) from which a name may be what was meant."""


def unknown(where: str, name: str, known: Iterable[str]) -> UsageError:
    """The error for a name that does not exist: the nearest one and all there are.

    Args:
        where: What the name should be one of, or the place where it was found.
        name: The name that was given.
        known: Names that exist.
    """
    return UsageError(f"{where}: unknown {name!r}{did_you_mean(name, known)}")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """End of a sentence about an unknown name: ", did you mean 'x'? There are: x, y".

    Args:
        name: The name that was given.
        known: Names that exist; they are listed up to LISTED, else counted.

    >>> did_you_mean("psrn", ["psnr", "flip"])
    ", did you mean 'psnr'? There are: flip, psnr"
    >>> did_you_mean("?", [])
    '. There are: none'
    """
    names = sorted(known)
    near = get_close_matches(name, names, n=1, cutoff=ALIKE)
    listed = ", ".join(names) if len(names) <= LISTED else f"{len(names)}"
    return (f", did you mean {near[0]!r}?" if near else ".") + f" There are: {listed or 'none'}"
