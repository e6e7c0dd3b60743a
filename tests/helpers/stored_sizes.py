"""What a stored model weighs, for tests of what is stored."""

import itertools
from pathlib import Path


def bytes_of_tensors(folder: Path) -> int:
    """Bytes of the numbers in a saved model's arrays, without the names before them."""
    path = folder / "model.safetensors"
    with path.open("rb") as file:
        names = int.from_bytes(file.read(8), "little")
    return path.stat().st_size - 8 - names


def numbers_of_layers(*widths: int) -> int:
    """Numbers of a network's layers: weights and biases."""
    return sum((before + 1) * after for before, after in itertools.pairwise(widths))
