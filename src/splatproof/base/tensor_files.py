"""Tensors on disk: safetensors that are there whole or not at all, read with one-line errors."""

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.files import size_of, whole_file
from splatproof.base.memory import check_room


def write_tensors(path: Path, tensors: Mapping[str, Tensor], facts: object = None) -> None:
    """Write named tensors and JSON-ready facts into one file that is there whole or not at all.

    Args:
        path: Name of the file; its folder is made, and a file that is there is replaced.
        tensors: Tensors by name, on any device.
        facts: JSON-ready content of the file's header, which `read_tensors` gives back.
    Raises: OSError where the disk does not take it.
    """
    content = {name: tensor.detach().contiguous() for name, tensor in tensors.items()}
    try:
        with whole_file(path) as partial:
            save_file(content, partial, metadata={"facts": json.dumps(facts)})
    except SafetensorError as error:
        number = re.search(r"os error (\d+)", str(error))
        if number is None:
            raise
        code = int(number[1])
        raise OSError(code, os.strerror(code), str(path)) from error


def read_tensors(path: Path, remedy: str = "") -> tuple[dict[str, Tensor], Any]:
    """Read what `write_tensors` wrote: the tensors and the facts.

    Args:
        path: The file.
        remedy: What to do where it is missing or damaged, for the error; "": nothing is said.
    Raises: DataError if the file is missing, cut short or not of this kind.
    """
    told = f"; {remedy}" if remedy else ""
    try:
        size = size_of(path)
    except DataError as error:
        raise DataError(f"{error}{told}") from None
    check_room(path, size)
    try:
        with safe_open(path, framework="pt") as file:
            facts = json.loads((file.metadata() or {}).get("facts", "null"))
            return {name: file.get_tensor(name) for name in file.keys()}, facts  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        found = str(error).splitlines()[0]
        raise DataError(f"{path}: not a whole safetensors file ({found}){told}") from None
