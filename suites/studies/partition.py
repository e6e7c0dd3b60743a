"""`bench study partition`: the partitions on a real scene where one is found, else on a made one."""

from collections.abc import Iterator
from typing import Any

from splatproof.base.errors import MissingError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import Scene
from splatproof.suites.partition import partition_rows


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """Rows of `suites.partition.partition_rows` for K = 4 and 8 on seneca, or K = 4 if quick.

    Where seneca is not found, and if quick, the scene is brighton_beach or the self-made courtyard.
    """
    names = ("brighton_beach", "courtyard") if quick else ("seneca", "brighton_beach", "courtyard")
    yield from partition_rows(first_found(names), (4,) if quick else (4, 8))


def first_found(names: tuple[str, ...]) -> Scene:
    """The first of these scenes that this machine has; the last one must be there."""
    protocol = load_protocol("default")
    for name in names[:-1]:
        try:
            return open_scene(name, protocol)
        except MissingError:
            continue
    return open_scene(names[-1], protocol)
