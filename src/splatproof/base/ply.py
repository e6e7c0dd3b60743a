"""The vertices of .ply files: read from text or binary of either byte order, written as binary.

Of our own because the libraries that do this well are under the GPL, which what depends on them would
have to be too; tests hold it against one of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes, whole_file

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
"""Numpy's name of each of the format's types."""
WRITTEN = {"u1": "uchar", "i4": "int", "f4": "float", "f8": "double"}
"""The name that is written for a type."""
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST = 2**20
"""Bytes in which a header must end."""
END = b"end_header"


@dataclass(frozen=True, kw_only=True, eq=False)
class Vertices:
    """The element `vertex` of a file."""

    rows: np.ndarray
    """A row a vertex, a field a property, in the file's types."""
    comments: tuple[str, ...]
    """The header's comments, without the word."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the properties in their order."""
        return self.rows.dtype.names or ()


def read_vertices(path: Path) -> Vertices:
    """Read the vertices; elements behind them are passed over.

    Args:
        path: A .ply file whose first element is `vertex`, without lists among its properties.
    Raises: DataError, in one line, naming the file and what is wrong; MissingError where memory is
        short.
    Source: G. Turk 1994, "The PLY Polygon File Format".
    """
    data = read_bytes(path)
    try:
        lines, body = _split(data)
        order, count, kinds, comments = _header(lines)
        rows = _text(body, count, kinds) if not order else _binary(body, count, kinds, order)
    except ValueError as error:
        raise DataError(f"{path}: not a whole .ply file ({error})") from None
    return Vertices(rows=rows, comments=comments)


def write_vertices(path: Path, rows: np.ndarray, comments: Sequence[str] = ()) -> None:
    """Write a binary little-endian file of one element, whole or not at all.

    Args:
        path: Name of the file.
        rows: A row a vertex, with a field of a type in WRITTEN a property.
        comments: Lines of the header.
    """
    kinds = {name: rows.dtype[name].str[1:] for name in rows.dtype.names or ()}
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    header.append(f"element vertex {len(rows)}")
    header += [f"property {WRITTEN[kind]} {name}" for name, kind in kinds.items()]
    packed = rows.astype([(name, f"<{kind}") for name, kind in kinds.items()], copy=False)
    with whole_file(path) as partial, partial.open("wb") as file:
        file.write(("\n".join([*header, END.decode()]) + "\n").encode("ascii"))
        packed.tofile(file)


def _split(data: bytes) -> tuple[list[str], bytes]:
    """Lines of the header, and what comes behind it."""
    if data[:3] not in (b"ply", b"PLY"):
        raise ValueError("it does not begin with 'ply'")
    end = data.find(END, 0, LONGEST)
    if end < 0:
        raise ValueError(f"no {END.decode()!r} in its first {LONGEST} bytes")
    start = end + len(END)
    start += 2 if data[start : start + 2] == b"\r\n" else 1
    return data[:end].decode("utf-8", "replace").splitlines(), data[start:]


def _header(lines: list[str]) -> tuple[str, int, list[tuple[str, str]], tuple[str, ...]]:
    """Byte order, number of vertices, names and types of their properties, comments."""
    order, count, kinds, comments, element = "", -1, dict[str, str](), [], ""
    formatted = False
    for line in lines[1:]:
        match line.split():
            case ["format", kind, "1.0"] if kind in ORDERS:
                order, formatted = ORDERS[kind], True
            case ["comment" | "obj_info", *_]:
                comments.append(line.split(maxsplit=1)[1] if len(line.split()) > 1 else "")
            case ["element", "vertex", number] if not element and _whole(number):
                element, count = "vertex", int(number)
            case ["element", name, number] if element and name != "vertex" and _whole(number):
                element = name
            case ["property", "list", _, _, _] if element not in ("", "vertex"):
                pass
            case ["property", kind, name] if element and kind in TYPES:
                if element == "vertex" and name in kinds:
                    raise ValueError(f"property {name!r} twice")
                if element == "vertex":
                    kinds[name] = TYPES[kind]
            case []:
                pass
            case _:
                raise ValueError(
                    f"header line {line[:60]!r}; expected vertices first, without lists"
                )
    if not formatted or count < 0 or (count and not kinds):
        raise ValueError("no format, no element 'vertex' or no properties in the header")
    return order, count, list(kinds.items()), tuple(comments)


def _whole(number: str) -> bool:
    return number.isascii() and number.isdecimal() and len(number) < 19


def _binary(body: bytes, count: int, kinds: list[tuple[str, str]], order: str) -> np.ndarray:
    row = np.dtype([(name, order + kind) for name, kind in kinds])
    if count * row.itemsize > len(body):
        raise ValueError(f"{count} vertices of {row.itemsize} bytes, {len(body)} bytes are there")
    rows = np.frombuffer(body, dtype=row, count=count) if kinds else np.zeros(0, row)
    return rows.astype(row.newbyteorder("="), copy=False)


def _text(body: bytes, count: int, kinds: list[tuple[str, str]]) -> np.ndarray:
    if 2 * count * len(kinds) > len(body) + 1:
        raise ValueError(f"{count} vertices of {len(kinds)} numbers, {len(body)} bytes are there")
    words = body.split(maxsplit=count * len(kinds))[: count * len(kinds)]
    if len(words) < count * len(kinds):
        raise ValueError(
            f"{count} vertices of {len(kinds)} numbers, {len(words)} numbers are there"
        )
    table = np.array(words, dtype=np.float64).reshape(count, len(kinds))
    rows = np.zeros(count, dtype=kinds)
    for column, (name, kind) in zip(table.T, kinds, strict=True):
        if kind[0] in "iu":
            least, most = np.iinfo(kind).min, np.iinfo(kind).max
            if not ((column >= least) & (column <= most) & (column == np.floor(column))).all():
                raise ValueError(f"property {name!r} has a number that its type cannot hold")
        with np.errstate(over="ignore"):
            rows[name] = column
    return rows
