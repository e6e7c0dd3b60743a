"""Numbers as the page gets them: short, and JSON that every browser reads."""

import json
import math
from typing import Any

DIGITS = 6
"""Significant digits; the record has all of them."""


def short(value: float | None) -> float | int | str | None:
    """A number with DIGITS significant digits; None where undefined, text where infinite."""
    if value is None or math.isnan(value):
        return None
    if math.isinf(value):
        return "Infinity" if value > 0 else "-Infinity"
    rounded = float(f"{value:.{DIGITS}g}")
    return int(rounded) if rounded.is_integer() and abs(rounded) < 2**53 else rounded


def plain_value(value: object) -> Any:
    """A setting or a rule as JSON has it: non-finite numbers as text, what is no plain data as its text."""
    if isinstance(value, float):
        return short(value) if math.isfinite(value) else str(value)
    if isinstance(value, (list, tuple)):
        return [plain_value(one) for one in value]
    if isinstance(value, dict):
        return {str(name): plain_value(one) for name, one in value.items()}
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)


def script(name: str, plain: Any) -> str:
    """A script that hands data to the page: pages opened from disk may load scripts, nothing else.

    Args:
        name: What the page asked for.
        plain: Plain data without non-finite numbers.
    """
    text = json.dumps(plain, separators=(",", ":"), allow_nan=False)
    # a string, since browsers parse JSON several times faster than the same text as a program
    return f"splatproof.take({json.dumps(name)},{json.dumps(text)});\n"
