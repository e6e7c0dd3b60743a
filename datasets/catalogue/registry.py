"""The known scenes: what they are, where they are looked for, and how to get them."""

import functools
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.base.files import sha256
from splatproof.base.inside import checked_name
from splatproof.base.locks import locked
from splatproof.base.names import unknown
from splatproof.base.typed_toml import build, read_toml
from splatproof.datasets.archives import extract
from splatproof.datasets.cache_folder import ELSEWHERE, cache_folder
from splatproof.datasets.download import download
from splatproof.datasets.progress import bar

FILE = "registry.toml"
"""The registry beside this module; a data root may hold one of its own with further scenes."""
SCENE = "<scene>"
"""Stands for the scene's name in a set's `folders` and `get`."""
OTHER_ROOT = "let SPLATPROOF_DATA begin with a folder that can be written"
DEFAULT_ROOTS = ("data", "../shared/data")
Kind = Literal["real", "made", "public"]
Report = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class SceneEntry:
    """One registered scene."""

    name: str
    kind: Kind
    """real: photos we test with; made: ray-cast by this package; public: a published set's scene."""
    licence: str
    source: str
    """Who made it, in words."""
    about: str
    """What it shows, in words."""
    home: str = ""
    """Web page of the data."""
    get: str = ""
    """What to do by hand to have it; "" where the package can do it."""
    protocols: tuple[str, ...] = ()
    """Names of the protocols that are meant for it."""
    folders: tuple[str, ...] = ()
    """Where it is looked for below each data root, best first."""
    files: dict[str, str] = field(default_factory=dict)
    """sha256 of files of the scene, where known."""
    url: str = ""
    """Archive that `bench scenes get` downloads."""
    sha256: str = ""
    """Sha256 of that archive, in hex."""
    world: str = ""
    """Name of the procedural world that makes the scene; "" where none does."""
    preset: str = ""
    seed: int = 0
    part: str = ""
    """Folder of the scene inside what the world makes; "" for all of it."""


def data_roots() -> tuple[Path, ...]:
    """Folders that scenes are looked for in: SPLATPROOF_DATA (a path list), else the defaults."""
    named = os.environ.get("SPLATPROOF_DATA")
    parts = named.split(os.pathsep) if named else DEFAULT_ROOTS
    return tuple(Path(part) for part in parts if part)


def read_registry(path: Path) -> tuple[SceneEntry, ...]:
    """Read a registry file: a table for each scene, or for a set with its list `scenes`.

    Raises: DataError naming the entry and the field.
    """
    data = read_toml(path, DataError)
    entries = []
    for name, table in data.items():
        if not isinstance(table, dict):
            raise DataError(f"{path}: {name!r} is {table!r}, expected a table [{name}]")
        scenes = table.pop("scenes", None)
        if scenes is None:
            entries.append(_entry(path, name, table))
            continue
        if not isinstance(scenes, list) or not all(isinstance(part, str) for part in scenes):
            raise DataError(f"{path}: [{name}]: scenes is {scenes!r:.80}, expected a list of names")
        for part in scenes:
            inside: dict[str, object] = {"part": part} if table.get("kind") == "made" else {}
            if isinstance(table.get("get"), str):
                inside["get"] = table["get"].replace(SCENE, part)
            if isinstance(table.get("folders"), list):
                inside["folders"] = [str(f).replace(SCENE, part) for f in table["folders"]]
            entries.append(_entry(path, f"{name}/{part}", {**table, **inside}))
    return tuple(entries)


def _entry(path: Path, name: str, table: dict[str, object]) -> SceneEntry:
    where = f"{path}: [{name}]"
    if "name" in table:
        raise DataError(f"{where}: name is given, but the table's own name is the scene's")
    checked_name(name, f"{path}: [{name!r}]")
    entry = build(SceneEntry, {"folders": [name], **table, "name": name}, where, DataError)
    parts = [("part", entry.part)] if entry.part else []
    for key, value in [*parts, *(("folders", folder) for folder in entry.folders),
                       *(("files", file) for file in entry.files)]:  # fmt: skip
        checked_name(value, f"{where}: {key}")
    if bool(entry.url) != bool(entry.sha256):
        raise DataError(f"{where} needs both url and sha256, or neither")
    return entry


@functools.cache
def _builtin() -> tuple[SceneEntry, ...]:
    return read_registry(Path(__file__).with_name(FILE))


def list_scenes() -> tuple[SceneEntry, ...]:
    """Every registered scene, by name; a data root's own entries win over the package's."""
    entries = {entry.name: entry for entry in _builtin()}
    for root in reversed(data_roots()):
        if (root / FILE).is_file():
            entries |= {entry.name: entry for entry in read_registry(root / FILE)}
    return tuple(entries[name] for name in sorted(entries))


def get_entry(name: str) -> SceneEntry:
    """The entry of a name. Raises: UsageError naming the nearest one."""
    entries = {entry.name: entry for entry in list_scenes()}
    if name in entries:
        return entries[name]
    if name.startswith((".", "/", "~")):
        raise UsageError(f"{name}: no such folder; `bench scenes list` has the registered scenes")
    raise unknown("scene (a folder, or a name of `bench scenes list`)", name, entries)


def locate(entry: SceneEntry) -> Path | None:
    """Folder of a scene that is here already, or None."""
    if entry.kind == "made":
        path = made_folder(entry)
        return path / entry.part if path.is_dir() else None
    for root in data_roots():
        for folder in entry.folders:
            if (root / folder).is_dir():
                return root / folder
    return None


def find_scene(name: str, report: Report | None = None) -> Path:
    """Folder of a registered scene; a made one is made when it is asked for first.

    Args:
        name: A name that `bench scenes list` has.
        report: Told (steps done, steps in all) while a scene is made; None: a bar on stderr.

    Raises: UsageError for an unknown name; MissingError for a scene that is not on this machine,
        saying where it was looked for and how to get it.
    """
    entry = get_entry(name)
    found = locate(entry)
    if found is not None:
        return found
    if entry.kind == "made":
        return make_entry(entry, report)
    raise MissingError(absence(entry))


def absence(entry: SceneEntry) -> str:
    """Where a scene was looked for in vain, and how to get it."""
    looked = ", ".join(str(root / folder) for root in data_roots() for folder in entry.folders)
    how = f"run `bench scenes get {entry.name}`" if entry.url else entry.get
    page = f" (home page {entry.home})" if entry.home and entry.home not in how else ""
    return (
        f"{entry.name}: not on this machine; looked for {looked} (set SPLATPROOF_DATA to the "
        f"folders that hold your data). To get it: {how}{page}"
    )


def made_folder(entry: SceneEntry) -> Path:
    """Folder in the cache of what a made scene's world makes, named by its content."""
    from splatproof.datasets.procedural import worlds

    content = worlds.content(entry.world, entry.preset, entry.seed)
    return cache_folder() / "scenes" / content / entry.world


def make_entry(entry: SceneEntry, report: Report | None = None) -> Path:
    """Make a made scene in the cache unless it is there; a second process waits and finds it.

    Args:
        entry: A scene whose kind is "made".
        report: Told (steps done, steps in all) while the world is made; None: a bar on stderr.
    Returns: The scene's folder.
    """
    from splatproof.datasets.procedural import worlds

    folder = made_folder(entry)
    with locked(folder.with_name(f".{entry.world}.lock"), elsewhere=ELSEWHERE):
        if not folder.is_dir() and report is not None:
            worlds.make(entry.world, entry.preset, entry.seed, folder, report)
        elif not folder.is_dir():
            with bar(f"making the world {entry.world}") as shown:
                worlds.make(entry.world, entry.preset, entry.seed, folder, shown)
    return folder / entry.part


def fetch_entry(entry: SceneEntry, report: Report = lambda done, total: None) -> Path:
    """Download and unpack a scene below the first data root; the archive is deleted then.

    Args:
        entry: A scene with the `url` and the `sha256` of its archive.
        report: Told (bytes so far, bytes in all or 0 where the server does not say).
    Returns: The scene's folder; one that is there already is left alone.
    Raises: MissingError if it has to be got by hand, or the download fails; DataError for an
        archive with another checksum or one that cannot be unpacked.
    """
    if not entry.url:
        raise MissingError(absence(entry))
    folder = data_roots()[0] / entry.folders[0]
    with locked(folder.with_name(f".{folder.name}.lock"), elsewhere=OTHER_ROOT):
        if folder.is_dir():
            return folder
        archive = folder.with_name(f".{folder.name}.archive")
        download(entry.url, archive, sha256=entry.sha256, report=report)
        extract(archive, folder)
        archive.unlink()
    return folder


def changed_files(entry: SceneEntry, folder: Path) -> list[str]:
    """Files of a scene that are missing or differ from the registry's checksums.

    Args:
        entry: A scene; its `files` has the checksums that are known.
        folder: The scene's folder on this machine.
    """
    return [
        name
        for name, digest in sorted(entry.files.items())
        if not (folder / name).is_file() or sha256(folder / name) != digest
    ]
