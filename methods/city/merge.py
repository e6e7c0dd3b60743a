"""The merged model, written block by block and slice by slice: never in memory as a whole."""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatbench.methods.city.block_model import BlockModel
from splatbench.methods.reconstruction import ARRAYS, DESCRIPTION, FIELDS, write_description
from splatbench.reference.errors import DataError
from splatbench.reference.rasterizer import Mode


def write_merged(
    folder: Path,
    blocks: Sequence[BlockModel],
    kept: Sequence[Bool[Tensor, " _"]],
    *,
    method: str,
    settings: Mapping[str, Any],
    mode: Mode = "classic",
    shift: Float[Tensor, "3"],
    units: str = "sfm",
) -> tuple[int, ...]:
    """Write what each block keeps as one model folder, as ExplicitModel.save does, but streaming.

    Primitives lie block after block, in their own order: the numbers returned say whose is whose.

    Args:
        folder: Of the merged model; a folder that was interrupted is refused by load_reconstruction.
        blocks: All of the same SH degree, in float32.
        kept: Which primitives of each block stay (stitch, cut_hard).
        method: Name of the row that made it.
        settings: Every setting it was made with, JSON-ready.
        mode: How it is rasterized.
        shift: Float64; back to the original frame.
        units: Name of the length unit.

    Returns: Number of primitives that each block contributes.

    Raises: DataError for blocks of different SH degree, or when nothing is kept.
    """
    bands = {block.bands for block in blocks}
    if len(bands) != 1:
        raise DataError(f"blocks with {sorted(bands)} SH bands: expected the same in all")
    (count,) = bands
    counts = tuple(int(mask.sum()) for mask in kept)
    total = sum(counts)
    if total == 0:
        raise DataError(
            f"all {len(blocks)} blocks lost every primitive in the merge: were they trained in the "
            "frame of their regions?"
        )
    (folder / DESCRIPTION).unlink(missing_ok=True)
    shapes = {"means": (3,), "quaternions": (4,), "log_scales": (3,), "opacity_logits": (),
              "sh": (count, 3)}  # fmt: skip
    layout = {name: (total, *shapes[name]) for name in FIELDS}
    parts = chain.from_iterable(_kept_parts(blocks, kept, name) for name in FIELDS)
    write_float_stream(folder / ARRAYS, layout, parts)
    write_description(
        folder, method=method, settings=settings, mode=mode, shift=shift, units=units,
        primitives=total, degree=round(count**0.5) - 1,
    )  # fmt: skip
    return counts


def write_float_stream(
    path: Path, shapes: Mapping[str, tuple[int, ...]], parts: Iterator[Float[Tensor, "..."]]
) -> None:
    """Write a .safetensors file of float32 arrays from a stream of their rows.

    Args:
        path: Written whole or not at all.
        shapes: Of each array, in the order of the stream.
        parts: Rows of the first array in order, then of the second, and so on.

    Raises: DataError if the stream holds more or less than the shapes say.

    Source: the safetensors format (8 bytes header length, JSON header, arrays).
    """
    header: dict[str, Any] = {"__metadata__": {"facts": "null"}}
    end = 0
    for name, shape in shapes.items():
        size = 4 * torch.Size(shape).numel()
        header[name] = {"dtype": "F32", "shape": list(shape), "data_offsets": [end, end + size]}
        end += size
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            file.write(len(text).to_bytes(8, "little") + text)
            for part in parts:
                file.write(
                    part.detach().float().contiguous().numpy().astype("<f4", copy=False).data
                )
            written = file.tell() - 8 - len(text)
        if written != end:
            raise DataError(f"{path}: {written} bytes of arrays, expected {end}")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _kept_parts(
    blocks: Sequence[BlockModel], kept: Sequence[Bool[Tensor, " _"]], name: str
) -> Iterator[Tensor]:
    """One parameter of everything that is kept, in slices."""
    for block, mask in zip(blocks, kept, strict=True):
        start = 0
        for part in block.slices((name,)):
            yield part[name][mask[start : start + len(part[name])]]
            start += len(part[name])
