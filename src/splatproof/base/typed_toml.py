"""TOML tables as dataclasses: strict types, unknown keys refused with the nearest name."""

import dataclasses
import functools
import json
import tomllib
import typing
from collections.abc import Mapping
from pathlib import Path
from types import GenericAlias
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from splatproof.base.errors import SplatproofError, UsageError
from splatproof.base.files import read_text
from splatproof.base.names import unknown
from splatproof.base.numbers import check_numbers

T = TypeVar("T")
STRICT = ConfigDict(extra="forbid", strict=True)


def read_toml(path: Path, fault: type[SplatproofError] = UsageError) -> dict[str, Any]:
    """The tables of a TOML file.

    Args:
        path: The file, in UTF-8.
        fault: Type of the error that is raised: DataError for a file that belongs to data.
    Raises: `fault` naming the file when it is missing, not text or not TOML, or has a number that
        nothing can mean.
    """
    try:
        tables = tomllib.loads(read_text(path, fault))
    except (ValueError, RecursionError) as error:
        raise fault(f"{path}: not a TOML file: {error}") from None
    check_numbers(tables, f"{path}: ", fault)
    return tables


def build(
    kind: type[T],
    table: Mapping[str, object],
    where: str,
    fault: type[SplatproofError] = UsageError,
) -> T:
    """A table as a dataclass, nested ones included; only whole numbers change type, to floats.

    Args:
        kind: Frozen dataclass of plain types, tuples, dicts, unions and such dataclasses.
        table: The table, as it was read from TOML.
        where: File and place in it, for errors.
        fault: Type of the error that is raised: DataError for a file that belongs to data.
    Raises: `fault` naming the key, what was found and what was expected.
    """
    try:
        # Strict JSON lets an array be a tuple but neither 1 be true nor "1" be 1. A tuple around
        # `kind`, because pydantic lets only what is not a dataclass itself take a configuration.
        text = json.dumps([table], default=str)
        return _adapter(kind).validate_json(text)[0]
    except ValidationError as error:
        found = error.errors(include_url=False)
        # a key that is not known says more than the one that is therefore missing
        first = min(found, key=lambda one: one["type"] != "unexpected_keyword_argument")
        raise fault(_told(kind, first["loc"][1:], dict(first), where)) from None
    except SplatproofError as error:  # the dataclass checks its own values
        raise fault(f"{where}: {error}") from None
    except (ValueError, RecursionError) as error:  # text with half a letter in it, or deep nesting
        raise fault(f"{where}: cannot be read ({error})") from None


@functools.cache
def _adapter(kind: type) -> TypeAdapter:
    """What checks tables of one kind; making it takes longer than a thousand checks."""
    around: Any = GenericAlias(tuple, (kind,))
    return TypeAdapter(around, config=STRICT)


def _told(kind: type, place: tuple[int | str, ...], fault: Mapping[str, Any], where: str) -> str:
    if fault["type"] == "unexpected_keyword_argument":
        inside = ("." if ": " in where else ": ") + _place(place[:-1]) if place[:-1] else ""
        owner = where + inside
        return str(unknown(owner, str(place[-1]), _keys_at(kind, place[:-1])))
    key = _place(place) or "file"
    if fault["type"] == "missing":
        return f"{where}: {key} is missing"
    return f"{where}: {key}: {fault['msg']}, found {fault['input']!r}"


def _place(steps: tuple[int | str, ...]) -> str:
    """A place in TOML as people write it: cases[0].settings."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return text.removeprefix(".")


def _keys_at(kind: Any, place: tuple[int | str, ...]) -> list[str]:
    """Names of the fields of the dataclass at a place inside `kind`."""
    for step in place:
        if dataclasses.is_dataclass(kind):
            kind = typing.get_type_hints(kind)[str(step)]
        else:  # tuple[X, ...] or dict[str, X]
            kind = next(part for part in typing.get_args(kind) if dataclasses.is_dataclass(part))
    return [field.name for field in dataclasses.fields(kind)]
