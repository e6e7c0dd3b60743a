"""What a check of one of the project's own claims measured."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Checked:
    """One run of a check."""

    check: str
    """Its name."""
    values: tuple[float, ...]
    """What was measured, one a repetition or a case."""
    unit: str
    """Unit of the values; empty: none."""
    compared: str
    """What was held against what, in words."""
    machine: str = ""
    """Where it was measured."""
    reduced: bool = False
    """Whether the cases were those of the reduced form."""
    error: str = ""
    """One line saying why nothing could be measured; empty where it was."""
