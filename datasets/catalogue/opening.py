"""Opens a scene by its registered name or its folder, with the adapter that knows such folders."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from traceback import extract_tb
from typing import TypeVar

from splatproof.base.errors import DataError, SplatproofError, UsageError
from splatproof.base.plugin_files import PluginFile, plugin_files
from splatproof.base.plugins import with_plugins
from splatproof.datasets.adapters import (
    kitti,
    levir_nvs,
    llff,
    matrix_city,
    mega_nerf,
    photo_tourism,
    transforms,
    waymo,
)
from splatproof.datasets.added_views import with_tests
from splatproof.datasets.colmap import open_colmap
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene

T = TypeVar("T")
GROUP = "splatproof.adapters"
"""Entry point group of other packages' adapters."""


@dataclass(frozen=True, kw_only=True)
class Adapter:
    """A kind of scene folder: how it is recognised and opened."""

    name: str
    """What lists and errors call it; letters, digits and "-"."""
    looks_for: str
    """What a folder must have, in words."""
    recognises: Callable[[Path], bool]
    """Looks at a folder, briefly and without changing it: whether this adapter can open it."""
    open: Callable[[Path, Protocol], Scene]
    """Opens a folder that is recognised. Photos keep their size, cameras and split as the protocol
    says (`assemble.open_layout` does that for any layout); no image is decoded."""


ADAPTERS = (
    Adapter(
        name="colmap",
        looks_for="a COLMAP model in sparse/0 or sparse, with photos in photos or images",
        recognises=lambda folder: (folder / "sparse").is_dir(),
        open=open_colmap,
    ),
    Adapter(
        name="photo-tourism",
        looks_for="a COLMAP model in dense/sparse, photos in dense/images, one .tsv",
        recognises=photo_tourism.recognises,
        open=photo_tourism.open_photo_tourism,
    ),
    Adapter(
        name="nerfstudio",
        looks_for="transforms.json",
        recognises=lambda folder: (folder / "transforms.json").is_file(),
        open=transforms.open_nerfstudio,
    ),
    Adapter(
        name="matrixcity",
        looks_for="pose/<block>/transforms_train.json, or train/<block>/transforms.json",
        recognises=matrix_city.recognises,
        open=matrix_city.open_matrix_city,
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
        name="llff",
        looks_for="poses_bounds.npy",
        recognises=llff.recognises,
        open=llff.open_llff,
    ),
    Adapter(
        name="kitti-raw",
        looks_for="oxts/data and image_02/data, calibration files one folder up",
        recognises=kitti.recognises_raw,
        open=kitti.open_raw,
    ),
    Adapter(
        name="kitti-tracking",
        looks_for="a folder image_02/<sequence> with calib/<sequence>.txt two folders up",
        recognises=kitti.recognises_tracking,
        open=kitti.open_tracking,
    ),
    Adapter(
        name="drivestudio",
        looks_for="ego_pose, extrinsics, intrinsics and images",
        recognises=waymo.recognises_drivestudio,
        open=waymo.open_drivestudio,
    ),
    Adapter(
        name="pvg",
        looks_for="calib, pose and image_0",
        recognises=waymo.recognises_pvg,
        open=waymo.open_pvg,
    ),
    Adapter(
        name="levir-nvs",
        looks_for="Images and Cams",
        recognises=levir_nvs.recognises,
        open=levir_nvs.open_levir_nvs,
    ),
)
"""Our own, in the order in which they are asked; see `all_adapters`."""


def all_adapters() -> dict[str, Adapter]:
    """Every adapter; the first that recognises a folder opens it.

    Installed packages add theirs through entry points of the group GROUP, each of which loads to an
    `Adapter` and has its name; plug-in files have theirs at their top level. Packages are looked up
    at the first call, so that importing this module loads no other package.

    Returns: Ours by name, then those of other packages, then those of plug-in files.
    Raises: UsageError, naming the package or file, where an entry point cannot be loaded or is no
        Adapter, or where its name is another than the adapter's or one that is in use.
    """
    return _all_adapters(plugin_files())


@functools.cache
def _all_adapters(_: tuple[PluginFile, ...]) -> dict[str, Adapter]:
    table = with_plugins({adapter.name: adapter for adapter in ADAPTERS}, GROUP, Adapter)
    for name, adapter in table.items():
        if name != adapter.name:
            raise UsageError(
                f"entry point {name} in {GROUP}: its adapter is called {adapter.name!r}; both must "
                "have one name, by which lists and errors know it"
            )
    return table


def open_scene(spec: str | Path, protocol: Protocol) -> Scene:
    """Open a scene under a protocol: images, sizes, cameras and split follow the protocol's rules.

    Args:
        spec: A scene folder, or a registered name; an existing folder goes first.
        protocol: The rules that the scene is opened under.

    Returns: The scene; no image has been decoded yet, unless points are triangulated.
    Raises: DataError naming the file and fault, or listing what was looked for in the folder;
        UsageError for an installed package whose adapter cannot be used.
    """
    folder = Path(spec)
    if not folder.is_dir():
        # imported late: a folder can be opened without the registry's file
        from splatproof.datasets.catalogue.registry import find_scene

        folder = find_scene(str(spec))
    scene = _with_test_views(folder, protocol)
    if protocol.points == "scene":
        return scene
    from splatproof.datasets.triangulation import with_triangulated  # brings COLMAP's matcher

    return with_triangulated(scene)


def _with_test_views(folder: Path, protocol: Protocol) -> Scene:
    """Open a folder, its test views from the protocol's test folder where it names one."""
    if not protocol.test_folder:
        return _open_folder(folder, protocol)
    whole = replace(protocol, hold=0, test_folder="", train_views=0, scored="held-out")
    tests = folder / protocol.test_folder
    if not tests.is_dir():
        raise DataError(
            f"{tests}: no such folder, but protocol {protocol.name!r} takes its test views from it"
        )
    return with_tests(_open_folder(folder, whole), _open_folder(tests, whole), protocol)


def adapter_of(folder: Path) -> Adapter:
    """The first adapter that recognises a scene folder.

    Raises: DataError that lists what was looked for; UsageError, see `all_adapters`.
    """
    adapters = all_adapters().values()
    for adapter in adapters:
        if _asked(adapter, adapter.recognises, folder):
            return adapter
    looked = "; ".join(f"{adapter.name}: {adapter.looks_for}" for adapter in adapters)
    raise DataError(
        f"{folder}: no scene found here; looked for {looked}; "
        "to make one from photos run `bench ingest PHOTOS OUT`"
    )


def _open_folder(folder: Path, protocol: Protocol) -> Scene:
    adapter = adapter_of(folder)
    scene = _asked(adapter, adapter.open, folder, protocol)
    if not isinstance(scene, Scene):
        raise UsageError(
            f"adapter {adapter.name}: open gave a {type(scene).__name__}, expected a Scene, which "
            "open_layout returns"
        )
    return scene


def _asked(adapter: Adapter, function: Callable[..., T], folder: Path, *more: object) -> T:
    """What a function of an adapter gives. Raises: UsageError where one of somebody else's fails."""
    try:
        return function(folder, *more)
    except Exception as error:
        of_a_file = isinstance(error, OSError) and function is adapter.open
        if adapter in ADAPTERS or of_a_file or isinstance(error, SplatproofError):
            raise
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise UsageError(
            f"adapter {adapter.name}: fails on {folder} ({said}{_place(error, function)}); mend it"
        ) from error


def _place(error: Exception, function: Callable[..., object]) -> str:
    """ "; rig.py:12", the last line of the function's own file that an error came through; "" if none did."""
    own = getattr(function, "__code__", None)
    frames = [
        one for one in extract_tb(error.__traceback__) if own and one.filename == own.co_filename
    ]
    return f"; {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
