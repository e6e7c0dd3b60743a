"""A .safetensors file of float32 arrays, written slice by slice."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import whole_file


def write_float_stream(
    path: Path, shapes: Mapping[str, tuple[int, ...]], slices: Iterable[Mapping[str, Tensor]]
) -> None:
    """Write arrays from a stream of their rows, of which one slice is in memory at a time.

    Args:
        path: Written whole or not at all.
        shapes: Shape of each array, by name; the file holds them in this order.
        slices: The next rows of each array, by name; any number of them at once.

    Raises: DataError if the stream holds more or less than the shapes say.

    Source: the safetensors format (8 bytes header length, JSON header, arrays).
    """
    header: dict[str, Any] = {"__metadata__": {"facts": "null"}}
    ends, end = {}, 0
    for name, shape in shapes.items():
        size = 4 * torch.Size(shape).numel()
        header[name] = {"dtype": "F32", "shape": list(shape), "data_offsets": [end, end + size]}
        end += size
        ends[name] = end
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    start = 8 + len(text)
    at = {name: header[name]["data_offsets"][0] for name in shapes}
    with whole_file(path) as partial, partial.open("wb") as file:
        file.write(len(text).to_bytes(8, "little") + text)
        for part in slices:
            for name, rows in part.items():
                data = rows.detach().float().contiguous().numpy().astype("<f4", copy=False)
                file.seek(start + at[name])
                at[name] += data.nbytes
                if at[name] > ends[name]:
                    raise DataError(f"{path}: more rows of {name} than {shapes[name]}")
                file.write(data.data)
        short = [name for name in shapes if at[name] < ends[name]]
        if short:
            raise DataError(f"{path}: fewer rows of {short[0]} than {shapes[short[0]]}")
