"""Opens a scene by its registered name or its folder; one line here for each kind of folder."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from splatbench.datasets.colmap import open_colmap
from splatbench.datasets.doors import levir_nvs, mega_nerf, transforms
from splatbench.reference.errors import DataError
from splatbench.reference.protocol import Protocol
from splatbench.reference.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Adapter:
    """A kind of scene folder: how it is recognised and opened."""

    name: str
    looks_for: str
    """What a folder must have, in words."""
    recognises: Callable[[Path], bool]
    open: Callable[[Path, Protocol], Scene]


ADAPTERS = (
    Adapter(
        name="colmap",
        looks_for="a COLMAP model in sparse/0 or sparse, with photos in photos or images",
        recognises=lambda folder: (folder / "sparse").is_dir(),
        open=open_colmap,
    ),
    Adapter(
        name="nerfstudio",
        looks_for="transforms.json",
        recognises=lambda folder: (folder / "transforms.json").is_file(),
        open=transforms.open_nerfstudio,
    ),
    Adapter(
        name="blender",
        looks_for="transforms_train.json and transforms_test.json",
        recognises=lambda folder: any((folder / n).is_file() for n in transforms.BLENDER_FILES),
        open=transforms.open_blender,
    ),
    Adapter(
        name="mega-nerf",
        looks_for="train/metadata and val/metadata with .pt files",
        recognises=mega_nerf.recognises,
        open=mega_nerf.open_mega_nerf,
    ),
    Adapter(
        name="levir-nvs",
        looks_for="Images and Cams",
        recognises=levir_nvs.recognises,
        open=levir_nvs.open_levir_nvs,
    ),
)
"""Tried in this order; the first that recognises a folder opens it."""


def open_scene(spec: str | Path, protocol: Protocol) -> Scene:
    """Open a scene under a protocol: images, sizes, cameras and split follow the protocol's rules.

    Args:
        spec: A scene folder, or a registered name; an existing folder goes first.
        protocol: The rules.

    Returns: The scene; no image has been decoded yet.
    Raises: DataError naming the file and fault, or listing what was looked for in the folder.
    """
    folder = Path(spec)
    if not folder.is_dir():
        # imported late: a folder can be opened without the registry's file
        from splatbench.datasets.registry import find_scene

        folder = find_scene(str(spec))
    for adapter in ADAPTERS:
        if adapter.recognises(folder):
            return adapter.open(folder, protocol)
    looked = "; ".join(f"{adapter.name}: {adapter.looks_for}" for adapter in ADAPTERS)
    raise DataError(
        f"{folder}: no scene found here; looked for {looked}; "
        "to make one from photos run `bench ingest PHOTOS OUT`"
    )
