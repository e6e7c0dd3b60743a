"""Which scenes of a suite are on this machine, before anything is run."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from splatproof.base.errors import MissingError, UsageError
from splatproof.datasets.catalogue.registry import absence, find_scene, get_entry, locate
from splatproof.suites.suite_files import PATH, Suite


def without_absent(suite: Suite) -> tuple[Suite, tuple[str, ...]]:
    """The suite without the optional scenes that are not here, and one line a scene saying why.

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
    """Scenes of the suite that are not here, each with where it was looked for and how to get it.

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


def make_scenes(suite: Suite, report: Callable[[int, int], None]) -> None:
    """Make the self-made scenes of the suite that are not made yet, so that no case is charged for it.

    Args:
        suite: Its scenes are known (see `without_absent`).
        report: Told (views done, views in all).
    """
    for scene in dict.fromkeys(case.scene for case in suite.cases):
        if not scene.startswith(PATH):
            find_scene(scene, report)
