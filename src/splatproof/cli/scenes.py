"""`bench scenes`: the registered scenes, and the worlds that the package makes."""

import sys
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from splatproof.base.errors import UsageError
from splatproof.cli import output
from splatproof.cli.scene_contents import contents

if TYPE_CHECKING:
    from splatproof.datasets.catalogue.registry import SceneEntry

Name = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]


def list_scenes(
    pattern: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[PATTERN]")] = "*",
    *,
    kind: Literal["made", "real", "public"] | None = None,
    present: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """List the registered scenes: kind, licence, and whether each is on this machine.

    With --json each scene is a line: name, kind, licence, present, path.

    Args:
        pattern: Only scenes whose name matches, e.g. "city*", or holds these letters.
        kind: Only made, real or public ones.
        present: Only those that are on this machine.
    """
    from splatproof.datasets.catalogue import registry

    rows = [
        (entry, path)
        for entry in registry.list_scenes()
        if (fnmatchcase(entry.name, pattern) or pattern in entry.name)
        and kind in (None, entry.kind)
        and ((path := registry.locate(entry)) or not present)
    ]
    if not rows:
        raise UsageError(
            f"no scene matches {pattern!r} and the options; `bench scenes list` has all"
        )
    if output.wants_json():
        for entry, path in rows:
            output.print_record(_summary(entry, path))
        return
    table = Table(box=None, pad_edge=False)
    for column in ("name", "kind", "licence", "present", "path"):
        table.add_column(column, overflow="fold")
    for entry, path in rows:
        here = "yes" if path else "makes itself" if entry.kind == "made" else "no"
        table.add_row(entry.name, entry.kind, entry.licence, here, str(path or ""))
    # a pipe has no width of its own: nothing is folded there
    width = None if sys.stdout.isatty() else 240
    Console(highlight=False, markup=False, width=width).print(table)


def show(name: Name) -> None:
    """Show everything that is known of one scene: source, licence, checksums, how to get it; or what a folder holds.

    Of a folder: its format, photos, sizes and points, and what else its views have (times, sensors, masks,
    LiDAR). With --json all of it is one line.

    Args:
        name: Name of the scene, as `bench scenes list` prints it, or a scene's folder, which goes first.
    """
    from splatproof.datasets.catalogue import registry

    if Path(name).is_dir():
        found = contents(Path(name))
        output.emit(found, _lines(found))
        return

    entry = registry.get_entry(name)
    path = registry.locate(entry)
    changed = registry.changed_files(entry, path) if path else []
    looked = [str(root / f) for root in registry.data_roots() for f in entry.folders]
    record = _summary(entry, path) | {
        "about": entry.about,
        "source": entry.source,
        "home": entry.home,
        "looked_for": [] if entry.kind == "made" else looked,
        "get": entry.get or f"bench scenes get {entry.name}",
        "protocols": list(entry.protocols),
        "files": entry.files,
        "changed_files": changed,
    }
    output.emit(record, _lines(record))


def get(name: Name) -> None:
    """Get a scene onto this machine: make it, or download, check and unpack it.

    Where a scene has to be downloaded by hand, it says from which page (exit code 3). The same
    command continues what was interrupted. With --json the scene is a line: name, kind, licence,
    present, path.

    Args:
        name: Name of the scene, as `bench scenes list` prints it.
    """
    from splatproof.datasets.catalogue import registry

    entry = registry.get_entry(name)
    path = registry.locate(entry)
    if path is None:
        with output.progress() as progress:
            task = progress.add_task(f"getting {name}", total=None, values="")

            def report(done: int, total: int) -> None:
                progress.update(task, completed=done, total=total or None)

            action = registry.make_entry if entry.kind == "made" else registry.fetch_entry
            path = action(entry, report)
    output.emit(_summary(entry, path), str(path))


def make(
    world: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="WORLD")],
    out: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[OUT]")] = None,
    *,
    preset: Annotated[str, tyro.conf.arg(metavar="small|medium|large")] = "small",
    seed: int = 0,
) -> None:
    """Make a procedural world as a COLMAP scene folder with true depth, normals and objects.

    The same command continues what was interrupted. With --json the world is a line: world, preset,
    seed, path.

    Args:
        world: Name of the world; an unknown name lists those that there are.
        out: Folder to make; must not exist yet. None: WORLD-PRESET-SEED in the current folder.
        preset: Size of the world: how many views there are, and how large.
        seed: Number that everything random in the world depends on.
    """
    from splatproof.datasets.procedural import worlds

    with output.progress() as progress:
        task = progress.add_task(f"making {world}", total=None, values="")

        def report(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        chosen = Path(f"{world}-{preset}-{seed}") if out is None else out
        path = worlds.make(world, preset, seed, chosen, report)
    if out is None:
        fit = f"bench fit auto {path} --out MODEL --seconds 60"
        output.log(f"made in the current folder; train on it: {fit}")
    record = {"world": world, "preset": preset, "seed": seed, "path": str(path)}
    output.emit(record, str(path))


def _summary(entry: "SceneEntry", path: Path | None) -> dict[str, object]:
    return {
        "name": entry.name,
        "kind": entry.kind,
        "licence": entry.licence,
        "present": path is not None,
        "path": str(path) if path else None,
    }


def _lines(record: dict[str, object]) -> str:
    """A record for a person, a line a value that there is."""
    told = ((key, value) for key, value in record.items() if value not in ("", [], {}, None))
    return "\n".join(f"{key}: {_words(value)}" for key, value in told)


def _words(value: object) -> str:
    """A value in words for a person."""
    if isinstance(value, list):
        return ", ".join(str(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key} {item}" for key, item in value.items())
    return "no" if value is False or value is None else "yes" if value is True else str(value)
