"""The small file of a city's merged model: on what steps, in what order, and how it is written."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Int64
from torch import Tensor

from splatproof.methods.city.settings import CitySettings
from splatproof.methods.storage.morton import morton_order
from splatproof.methods.storage.packed.coded_writer import (
    chosen_steps,
    file_order,
    with_room,
    write_coded,
)
from splatproof.methods.storage.packed.rows import MemoryRows
from splatproof.methods.storage.packed.writer import PackedFacts, write_packed
from splatproof.reference.compression.quantisers import Steps
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene


def file_steps(
    model: Gaussians, settings: CitySettings, refined: dict[str, Any] | None
) -> Steps | None:
    """Steps of our small file; None: there is no such file.

    Args:
        model: What is stored.
        settings: Whether it is, by what, and how finely.
        refined: Fields of the steps that the refinement saw colours on. They stay, but for cells, which refinement does
            not see: those are wide enough for what it moved. None: there was none yet.

    Raises: DataError for numbers that are not finite or beyond their grid.
    """
    if not settings.quantise or settings.coder == "paper":
        return None
    if refined is not None:
        known: dict[str, Any] = refined | {"weights": tuple(refined["weights"])}
        return with_room(Steps(**known), MemoryRows(model))
    return chosen_steps(MemoryRows(model), settings.code)


def order_in_file(
    model: Gaussians, settings: CitySettings, steps: Steps | None
) -> Int64[Tensor, " n"]:
    """The Gaussians in the order of the file that they will be read from.

    Args:
        model: What is stored.
        settings: Whether the paper's file is sorted.
        steps: Steps of our file; None: it is the paper's.
    """
    if steps is not None:
        return file_order(MemoryRows(model), steps)[1]
    return morton_order(model.means) if settings.pack.sort else torch.arange(len(model))


def compress(
    model: Gaussians, settings: CitySettings, path: Path, scene: Scene, steps: Steps | None
) -> dict[str, Any]:
    """Write the small file.

    Args:
        model: What is stored, in the order of the file.
        settings: How the paper's file is packed, or the profile of ours.
        path: The file.
        scene: Whose shift and units it keeps.
        steps: Steps of our file; None: the paper's is written.

    Returns: "parts": bytes of each part of it.
    """
    facts = PackedFacts(mode=settings.mode, shift=scene.shift, units=scene.units)
    threads = torch.get_num_threads()
    if steps is None:
        report = write_packed(
            path, model, settings=replace(settings.pack, sort=False), facts=facts, threads=threads
        )
    else:
        report = write_coded(
            path, model, settings=settings.code, steps=steps, facts=facts, threads=threads
        )
    return {"parts": dict(report.bytes_by_part)}
