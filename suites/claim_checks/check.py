"""What a check of a claim is."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """What a check found."""

    values: tuple[float, ...]
    """One a repetition or a case."""
    compared: str
    """What was held against what, in words."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One quantity that claims of this project are about."""

    measure: Callable[[bool, Path], Measurement]
    """measure(reduced, folder): the reduced form has smaller cases and fewer of them; the folder is
    empty and its own. Raises MissingError where this machine lacks what is compared."""
    unit: str
    """Unit of the values; empty: none."""
    seconds: tuple[float, float]
    """About how long it takes on two cores, and in the reduced form."""
