"""Damage to files: bytes, text and JSON changed at random, with the values that break readers."""

import copy
import json
import random
import re
import struct
from collections.abc import Callable, Sequence
from typing import Any

ODD_INTEGERS = (0, 1, 2, 3, 7, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**16, 2**24, 2**31 - 1, 2**31,
                2**32 - 1, 2**32, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 1)  # fmt: skip
ODD_FLOATS = (0.0, -0.0, 1e-45, 1e-38, -1.0, 1e20, 3.4e38, -3.4e38, 1e300, 5e-324, float("inf"),
              float("-inf"), float("nan"))  # fmt: skip
DIGITS = "1" + "0" * 400
"""10^400: a whole number that no float holds."""
DEEP = "@deep@"
"""Stands in a JSON tree for lists inside lists, deeper than a recursive reader goes."""
DEPTH = 20_000
DEEPS = 10
"""Such lists in one file: doubled a thousand times they would be a file of gigabytes."""
LARGEST = 2**22
"""Bytes of a changed file: one that was made 41 times as long four times was of gigabytes."""
WORDS = ("", "0", "-1", "1", "nan", "inf", "-inf", "1e400", "-1e-400", DIGITS, "0x10", "1_0", "٣",
         "1.5", "true", "null", "''", '"', "\\", "/", "..", "../../x", "/etc/passwd", ".", "\0",
         "\ufeff", "\u2028", "\x85", "#", "=", "[", "]]", "{", "}", ",", "[" * 500, "a.b=" * 200,
         "x" * 70_000, "999999999999", "4294967296", "18446744073709551616")  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 0.5, -0.0, 1e-320, 1e308, float("nan"), float("inf"), 2**31, 2**53 + 1,
    2**63, 2**64, 10**400, "", "0", "nan", "x" * 70_000, "\0", "\ud800", "\n", "a\nb", "..", "../../x",
    "/etc/passwd", ".", "/", [], {}, [[]], [None], [0, 0, 0], {"a": 1}, {"": {}}, DEEP,
)  # fmt: skip
BROKEN_UTF8 = (b"\xff\xfe", b"\xc3", b"\xed\xa0\x80", b"\0", b"\xef\xbb\xbf")
Change = Callable[[random.Random, bytes, Sequence[bytes]], bytes]


def changed_bytes(draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """One to four changes: bits, numbers written over, cuts, spans doubled, lost or from another file.

    Args:
        draw: Where chance comes from.
        data: What is changed.
        others: Whole files of the same kind, for spans.
    """
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        data = draw.choice(_BYTE_CHANGES)(draw, data, others)[:LARGEST]
    return data


def _place(draw: random.Random, size: int) -> int:
    """A position; headers, where sizes and counts lie, as often as all the rest."""
    return draw.randrange(min(size, draw.choice((16, 64, 10**9))) + 1) if size else 0


def _flip(draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    del others
    out = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8)) if out else 0):
        out[min(_place(draw, len(out)), len(out) - 1)] ^= 1 << draw.randrange(8)
    return bytes(out)


def _number(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    size, order = draw.choice((1, 2, 4, 8)), draw.choice("<<<>")
    if size >= 4 and draw.random() < 0.4:
        value = draw.choice(ODD_FLOATS)
        if size == 4 and abs(value) > 3.4e38:
            value = float("inf")
        word = struct.pack(f"{order}{'f' if size == 4 else 'd'}", value)
    else:
        value = draw.choice(ODD_INTEGERS) % 2 ** (8 * size)
        word = value.to_bytes(size, "little" if order == "<" else "big")
    at = _place(draw, len(data))
    at -= at % draw.choice((1, size))
    return data[:at] + word + data[at + size :]


def _cut(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    return data[: _place(draw, len(data))]


def _longer(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    return data + draw.choice((b"\0", b"\xff", draw.randbytes(7), data)) * draw.choice((1, 3, 40))


def _lost(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    at = _place(draw, len(data))
    return data[:at] + data[at + draw.choice((1, 4, 8, 100)) :]


def _doubled(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    at, length = _place(draw, len(data)), draw.choice((1, 4, 8, 100))
    return data[:at] + data[at : at + length] * draw.choice((2, 2, 50)) + data[at + length :]


def _spliced(draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    other = draw.choice(others)
    at = _place(draw, len(data))
    return data[:at] + other[draw.choice((at, _place(draw, len(other)))) :]


def _noise(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    at, length = _place(draw, len(data)), draw.choice((1, 4, 16, 64))
    return data[:at] + draw.randbytes(length) + data[at + length :]


_BYTE_CHANGES: tuple[Change, ...] = (
    _flip, _flip, _number, _number, _number, _cut, _longer, _lost, _doubled, _spliced, _noise,
)  # fmt: skip


def changed_text(draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """One to four changes to words and lines; rarely bytes that are no text.

    Args:
        draw: Where chance comes from.
        data: UTF-8 text; what is none is changed as bytes.
        others: Whole files of the same kind, for lines.
    """
    try:
        text = data.decode()
    except UnicodeDecodeError:
        return changed_bytes(draw, data, others)
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        text = draw.choice((_word, _word, _word, _lines, _character))(draw, text, others)
    data = text.encode("utf-8", "surrogatepass")
    if draw.random() < 0.05:
        at = _place(draw, len(data))
        data = data[:at] + draw.choice(BROKEN_UTF8) + data[at:]
    return data[: _place(draw, len(data))] if draw.random() < 0.05 else data


def _word(draw: random.Random, text: str, _: Sequence[bytes]) -> str:
    found = list(re.finditer(r"-?\d[\d.e+-]*|\"[^\"\n]*\"|[^\s,=\[\]{}\"<>]+", text))
    if not found:
        return text + draw.choice(WORDS)
    word = draw.choice(found)
    new = draw.choice((draw.choice(WORDS), draw.choice(found)[0], word[0] + draw.choice(WORDS)))
    return text[: word.start()] + new + text[word.end() :]


def _lines(draw: random.Random, text: str, others: Sequence[bytes]) -> str:
    lines = text.splitlines(keepends=True) or [""]
    at = draw.randrange(len(lines))
    match draw.randrange(6):
        case 0:
            del lines[at]
        case 1:
            lines.insert(at, lines[at])
        case 2:
            other = draw.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        case 3:
            lines = lines[:at]
        case 4:
            lines[at] = lines[at].rstrip("\n") + draw.choice(("", " ", "\r\n", "\r", "\x0c"))
        case _:
            strange = draw.choice(others).decode("utf-8", "replace").splitlines(keepends=True)
            lines[at : at + 1] = strange[: draw.choice((1, 50))]
    return "".join(lines)


def _character(draw: random.Random, text: str, _: Sequence[bytes]) -> str:
    at = _place(draw, len(text))
    return text[:at] + draw.choice((*WORDS, "")) + text[at + draw.choice((0, 1, 3)) :]


def changed_json(draw: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """One to three changes to the tree: values, keys, lengths, kinds; the rest stays JSON.

    Args:
        draw: Where chance comes from.
        data: JSON; what is none is changed as text.
        others: Whole files of the same kind, for parts.
    """
    if draw.random() < 0.1:
        return changed_text(draw, data, others)
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return changed_text(draw, data, others)
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        tree = _changed_tree(draw, tree)
    text = json.dumps(tree).replace(f'"{DEEP}"', "[" * DEPTH + "]" * DEPTH, DEEPS)
    return text.encode()


def _changed_tree(draw: random.Random, tree: Any) -> Any:
    """The tree with one place in it changed."""
    places: list[tuple[Any, Any]] = []
    _walk(tree, places)
    if not places:
        return copy.deepcopy(draw.choice(VALUES))
    owner, key = draw.choice(places)
    match draw.randrange(8):
        case 0:
            del owner[key]
        case 1 if isinstance(owner, dict):
            owner[draw.choice(("", "x", "\0", str(key) + " "))] = owner.pop(key)
        case 1 | 2 if isinstance(owner, list):
            owner[key : key + 1] = [owner[key]] * draw.choice((2, 3, 1000))
        case 3:
            other, place = draw.choice(places)
            owner[key] = json.loads(
                json.dumps(other.get(place) if isinstance(other, dict) else other[place])
            )
        case 4 if type(owner[key]) in (int, float) and abs(owner[key]) < 1e300:
            factor = draw.choice((-1, 0.5, 2, 1e3, 1e-3, 1e9, 1e300))
            owner[key] = draw.choice(
                (owner[key] * factor, str(owner[key]), [owner[key]], owner[key] + 1)
            )
        case _:
            owner[key] = copy.deepcopy(draw.choice(VALUES))
    return tree


def _walk(tree: Any, places: list[tuple[Any, Any]]) -> None:
    """Every (owner, key) in a tree."""
    items = (
        tree.items()
        if isinstance(tree, dict)
        else enumerate(tree)
        if isinstance(tree, list)
        else ()
    )
    for key, value in items:
        places.append((tree, key))
        _walk(value, places)
