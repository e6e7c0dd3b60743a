"""Numbers from command lines, TOML, JSON and headers: finite, in range, small enough to be stored."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from splatproof.base.errors import DataError, SplatproofError, UsageError

Number = int | float
"""Annotations of types are checked in tests, where a whole number is no float."""
LARGEST = 2**63 - 1
"""Largest whole number that torch, numpy and SQLite take."""
MOST_SIDE = 2**16
"""Pixels of the longest side of an image; no camera, and no image format that is read here, has more."""


def finite(value: object) -> float | None:
    """A value as a float; None where it is no finite real number.

    >>> finite(2), finite(True), finite("2"), finite(10**400), finite(float("nan"))
    (2.0, None, None, None, None)
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:  # a whole number of more than 308 digits
        return None
    return number if math.isfinite(number) else None


def in_range(
    value: Any,
    where: str,
    least: Number = 0,
    most: Number = LARGEST,
    *,
    above: bool = False,
    fault: type[SplatproofError] = UsageError,
) -> None:
    """Refuse a number that is not in its range, and what is no finite number at all.

    Args:
        value: The number, or what there is instead.
        where: The option, or file and place, that gives it; for errors.
        least: Smallest that is taken.
        most: Largest that is taken.
        above: Whether `least` itself is not taken.
        fault: Type of the error that is raised.
    Raises: `fault`.
    """
    number = finite(value)
    if number is not None and (least < value if above else least <= value) and value <= most:
        return
    start = "above" if above else "from"
    end = f"{start} {least:g} to {most:g}" if most < LARGEST else f"{start} {least:g}"
    raise fault(f"{where} is {_shown(value)}, expected {end}")


def check_numbers(value: object, where: str, fault: type[SplatproofError] = UsageError) -> None:
    """Refuse numbers that nothing can mean or store, wherever they are inside a value.

    Args:
        value: A number, or dataclasses, tables and lists of them; what else is there is left alone.
        where: The option, or file and place, for errors.
        fault: Type of the error that is raised.
    Raises: `fault` naming the place of a float that is not finite, or a whole number beyond 64 bits.
    """
    if isinstance(value, bool):
        return
    if isinstance(value, float) and not math.isfinite(value):
        raise fault(f"{where} is {value}, expected a finite number")
    if isinstance(value, int) and not -LARGEST <= value <= LARGEST:
        raise fault(f"{where} is {_shown(value)}, expected at most 2^63 - 1 in size")
    for name, part in _parts(value):
        name = name.replace("_", "-") if where.startswith("--") else name  # an option
        check_numbers(part, f"{where}{'.' if where[-1:].isalnum() else ''}{name}", fault)


def _parts(value: object) -> list[tuple[str, Any]]:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, Mapping):
        return [(str(name), part) for name, part in value.items()]
    if isinstance(value, list | tuple):
        return [(f"[{index}]", part) for index, part in enumerate(value)]
    return []


def image_size(width: object, height: object, where: str) -> tuple[int, int]:
    """Width and height of an image in pixels, as a file gives them.

    Args:
        width: What the file has, of any type; whole numbers may be floats.
        height: As `width`.
        where: File and place, for errors.
    Raises: DataError unless both are from 1 to MOST_SIDE.
    """
    sides = []
    for name, value in (("width", width), ("height", height)):
        number = finite(value)
        if number is None or not 1 <= number <= MOST_SIDE:
            raise DataError(
                f"{where}: {name} is {_shown(value)}, expected pixels, 1 to {MOST_SIDE}"
            )
        sides.append(int(number))
    return sides[0], sides[1]


def _shown(value: object) -> str:
    """A value in an error; Python itself refuses to print whole numbers of thousands of digits."""
    if isinstance(value, int) and abs(value) > LARGEST:
        return f"a whole number of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
