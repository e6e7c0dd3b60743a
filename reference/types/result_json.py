"""A Result as one line of strict JSON, and back without loss."""

import dataclasses
import json
import math
import types
import typing
from collections.abc import Mapping
from typing import Any

from splatproof.base.errors import DataError
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import NO_PRIOR, TRUE_POSES, Result

VERSION = 1
"""Version of the format; a reader refuses every other."""
NON_FINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
"""JSON has no such numbers, so they are written as these strings."""
RULES = {
    field.name: field.default
    for field in dataclasses.fields(Protocol)
    if field.default is not dataclasses.MISSING
}
"""A record from before a rule existed was made as the rule's default says."""


def result_to_json(result: Result) -> str:
    """One line of JSON with every field of the result under its own name, and "version".

    Non-finite floats become the strings of NON_FINITE; lists and tuples both become arrays.

    Args:
        result: A finished or failed case.
    Returns: Strict JSON (RFC 8259), keys in the order of the fields.
    Raises: TypeError naming the field whose value is not plain data.
    """
    record = {"version": VERSION}
    for field in dataclasses.fields(result):
        record[field.name] = plain(getattr(result, field.name), field.name)
    return json.dumps(record, allow_nan=False, ensure_ascii=False)


def result_from_json(text: str, source: str) -> Result:
    """The result that `result_to_json` wrote; arrays in free-form fields come back as tuples.

    Rules of the protocol that the record does not know are added with their defaults, so that it
    still stands beside results of later releases.

    Args:
        text: One line of JSON, as `result_to_json` wrote it.
        source: Name of the file, for errors.
    Raises: DataError where the text is not JSON, a key is missing or unknown, or a type is wrong.
    """
    try:
        record = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{source}: not a result record: {error}") from error
    if not isinstance(record, dict):
        raise DataError(f"{source}: expected a JSON object, found {_kind(record)}")
    version = record.pop("version", None)
    if version != VERSION or isinstance(version, bool):
        raise DataError(
            f"{source}: record version {version!r}, expected {VERSION}; run the case again "
            "or read it with the release that wrote it"
        )
    record.setdefault("pose_noise", TRUE_POSES)  # older than the noise
    record.setdefault("depth_prior", NO_PRIOR)  # older than priors
    record.setdefault("counters", {})  # older than counting
    record.setdefault("curve_seconds", [])  # older than its clock
    record.setdefault("timed", [])  # older than marks
    record.setdefault("turns", "")  # older than turns
    result = _read(record, Result, "result", source)
    newer = {name: rule for name, rule in RULES.items() if name not in result.protocol_rules}
    return dataclasses.replace(result, protocol_rules=result.protocol_rules | newer)


def plain(value: object, where: str) -> Any:
    """The value as JSON-ready data: dict, list, str, int, float, bool or None.

    Args:
        value: Plain data, or dataclasses of such.
        where: What it is called, for errors.
    Raises: TypeError naming the part that is not plain data.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: plain(getattr(value, name), f"{where}.{name}") for name in names}
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"{where}: key {key!r} is not a string")
        return {key: plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, f"{where}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else _non_finite_name(value)
    if isinstance(value, str) and value in NON_FINITE:
        raise TypeError(f"{where}: the string {value!r} is reserved for the float of that name")
    if value is None or isinstance(value, (str, int)):
        return value
    raise TypeError(f"{where}: {_kind(value)} is not plain data")


def _non_finite_name(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    return "Infinity" if value > 0 else "-Infinity"


def _read(value: Any, kind: Any, where: str, source: str) -> Any:
    """`value` as an instance of the annotation `kind`, or a DataError that names the field."""
    if kind is object:
        return _read_free(value)
    if dataclasses.is_dataclass(kind):
        return _read_dataclass(value, kind, where, source)
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is dict:
        _check(value, dict, where, source)
        return {k: _read(v, parts[1], f"{where}.{k}", source) for k, v in value.items()}
    if origin is tuple:
        _check(value, list, where, source)
        if parts[-1] is Ellipsis:
            parts = (parts[0],) * len(value)
        if len(value) != len(parts):
            raise DataError(f"{source}: {where}: expected {len(parts)} items, found {len(value)}")
        items = zip(value, parts, strict=True)
        return tuple(_read(v, p, f"{where}[{i}]", source) for i, (v, p) in enumerate(items))
    if kind is float:
        if isinstance(value, str) and value in NON_FINITE:
            return NON_FINITE[value]
        _check(value, int | float, where, source)
        try:
            return float(value)
        except OverflowError:
            raise DataError(f"{source}: {where}: {_kind(value)} is no float") from None
    _check(value, kind, where, source)
    return value


def _read_dataclass(value: Any, kind: Any, where: str, source: str) -> Any:
    _check(value, dict, where, source)
    hints = typing.get_type_hints(kind)
    missing, unknown = sorted(hints.keys() - value.keys()), sorted(value.keys() - hints.keys())
    for problem, names in (("lacks", missing), ("has the unknown key", unknown)):
        if names:
            raise DataError(f"{source}: {where} {problem} {', '.join(names)}")
    return kind(**{k: _read(value[k], hints[k], f"{where}.{k}", source) for k in hints})


def _read_free(value: Any) -> object:
    if isinstance(value, dict):
        return {key: _read_free(item) for key, item in value.items()}
    if isinstance(value, list):
        return tuple(_read_free(item) for item in value)
    return NON_FINITE.get(value, value) if isinstance(value, str) else value


def _check(value: object, kind: type | types.UnionType, where: str, source: str) -> None:
    """Refuse a value of another type; bool is not a number here."""
    if not isinstance(value, kind) or isinstance(value, bool):
        expected = str(kind) if isinstance(kind, types.UnionType) else kind.__name__
        raise DataError(f"{source}: {where}: expected {expected}, found {_kind(value)}")


def _kind(value: object) -> str:
    return f"{type(value).__name__} {str(value)[:40]!r}"


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON; non-finite numbers are strings here")
