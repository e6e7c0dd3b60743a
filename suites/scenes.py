"""Which scenes of a suite are on this machine, before anything is run."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from splatproof.base.errors import MissingError, UsageError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.catalogue.registry import absence, find_scene, get_entry, locate
from splatproof.reference.types.scene import Scene
from splatproof.suites.held_out import scored_views
from splatproof.suites.suite_files import PATH, Case, Suite


def without_absent(suite: Suite) -> tuple[Suite, tuple[str, ...]]:
    """Leave out the cases of optional scenes that are not on this machine.

    Args:
        suite: Suite whose scenes are looked for.
    Returns: The suite with the cases that can run, and one line for each scene that was left out.
    Raises: UsageError for a scene that is neither registered nor a folder, and MissingError for one
        that is not optional and not here: better now than after hours of other cases.
    """
    absent = absences(suite)
    for scene, reason in absent.items():
        if scene not in suite.optional_scenes:
            raise MissingError(reason)
    kept = tuple(case for case in suite.cases if case.scene not in absent)
    if not kept:
        raise MissingError(f"suite {suite.name}: no scene is here: {'; '.join(absent.values())}")
    return replace(suite, cases=kept), tuple(absent.values())


def absences(suite: Suite) -> dict[str, str]:
    """Find the scenes of the suite that are not here and cannot be made.

    Args:
        suite: Suite whose scenes are looked for.
    Returns: For each such scene where it was looked for and how to get it.
    Raises: UsageError for a scene that is neither registered nor a folder.
    """
    absent = {}
    for scene in dict.fromkeys(case.scene for case in suite.cases):
        try:
            check_scene(scene)
        except MissingError as error:
            absent[scene] = str(error)
    return absent


def check_scene(scene: str) -> None:
    """Raise if the scene is neither on this machine nor one that the package can make.

    Args:
        scene: Registered name, or folder as a path that starts with "/", "./" or "../".
    Raises: UsageError for an unknown name or folder; MissingError for a registered scene that has
        to be fetched first.
    """
    if scene.startswith(PATH):
        if not Path(scene).is_dir():
            raise UsageError(f"{scene}: no such scene folder")
        return
    entry = get_entry(scene)
    if entry.kind != "made" and locate(entry) is None:
        raise MissingError(absence(entry))


def not_made(suite: Suite) -> tuple[str, ...]:
    """Names of the suite's scenes that the package can make and has not made yet."""
    names = dict.fromkeys(case.scene for case in suite.cases if not case.scene.startswith(PATH))
    entries = (get_entry(name) for name in names)
    return tuple(e.name for e in entries if e.kind == "made" and locate(e) is None)


def without_side_effects(suite: Suite) -> Suite:
    """The suite for estimates alone: its scenes can be opened without anything being computed.

    Sparse points are the scene's own: triangulating them takes minutes and fills the cache.

    Args:
        suite: The suite; its scenes are on this machine.
    Returns: The same cases under protocols that open faster.
    """
    return replace(
        suite,
        cases=tuple(
            replace(case, protocol=replace(case.protocol, points="scene")) for case in suite.cases
        ),
    )


def make_scenes(suite: Suite, report: Callable[[int, int], None]) -> None:
    """Make the procedural scenes of the suite that are not made yet, so that no case is charged.

    Args:
        suite: The suite; its scenes are known (see `without_absent`).
        report: Hears how far it is: report(views done, views in all).
    """
    for scene in dict.fromkeys(case.scene for case in suite.cases):
        if not scene.startswith(PATH):
            find_scene(scene, report)


def check_opens(case: Case) -> Scene:
    """Open a case's scene as the case will: bad input is told before anything is written.

    Args:
        case: What is to be run; its scene is on this machine.

    Returns: The scene.
    Raises: DataError, UsageError or MissingError, as opening and scoring would.
    """
    scene = open_scene(case.scene, case.protocol)
    if scene.test:
        scored_views(scene, case.protocol)
    return scene
