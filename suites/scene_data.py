"""What a scene's name stands for now, and whether an earlier result was made of the same."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.base.files import read_json, write_text
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.fingerprint import Known, files_sha256
from splatproof.methods.dpgs.refiners import REFINER
from splatproof.methods.priors.kinds import WEIGHTS
from splatproof.methods.training.matchers import MATCHER
from splatproof.reference.types.protocol import Protocol

FILES = "files_sha256"
"""The fact of a record that this room adds to the scene's own."""
WORDS = {
    "model_sha256": "its COLMAP model",
    "cameras_sha256": "its camera files",
    "photos_sha256": "its photos",
    FILES: "its photos, masks or depth",
    WEIGHTS: "its depth prior's weights",
    REFINER: "its refiner's weights",
    MATCHER: "its matcher's weights",
}
"""Facts that depend on files alone, neither on code nor on protocol, most telling first."""
PLUGIN = "plugin "
"""Start of the facts that give the hash of each plug-in file that a case uses."""
TESTS = "tests_"
"""Start of the names of the same facts where test views have a folder of their own."""


class SceneData:
    """Facts of the scenes of a run, each found once."""

    def __init__(self, path: Path) -> None:
        """Read what earlier runs know.

        Args:
            path: File that remembers the hashes of files, so that only new ones are read.
        """
        self._path = path
        self._known = _read(path)
        self._found: dict[tuple[str, Protocol], dict[str, str]] = {}

    def of(
        self, scene: str, protocol: Protocol, report: Callable[[int, int], None]
    ) -> dict[str, str]:
        """The facts of a scene that name its data.

        Args:
            scene: Registered name or folder of the scene, as `open_scene` takes it.
            protocol: The rules that say which photos are used.
            report: Called as report(files looked at, files in all).
        Raises: What `open_scene` raises.
        """
        if (scene, protocol) not in self._found:
            opened, before = open_scene(scene, protocol), dict(self._known)
            facts = opened.facts | {FILES: files_sha256(opened, self._known, report)}
            self._found[scene, protocol] = {
                name: value for name, value in facts.items() if _plain(name) in WORDS and value
            }
            if self._known != before:
                write_text(self._path, json.dumps(self._known))
        return self._found[scene, protocol]


def changed(old: Mapping[str, str], new: Mapping[str, str]) -> str:
    """Say which data or plug-ins differ; empty where nothing does that both have.

    Args:
        old: Facts of the scene's files and of plug-ins when the result was made.
        new: The same facts now.
    Returns: Words such as "its photos" or "plugin my_method.py".
    """
    odd = [name for name in new if name in old and old[name] != new[name]]
    if not odd:
        return ""
    plugins = [name for name in odd if name.startswith(PLUGIN)]
    if plugins:
        return plugins[0]
    first = min(odd, key=lambda name: list(WORDS).index(_plain(name)))
    return "its test views" if first.startswith(TESTS) else WORDS[first]


def digest(data: Mapping[str, str]) -> str:
    """Twelve letters that name the data."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:12]


def _plain(name: str) -> str:
    return name.removeprefix(TESTS)


def _read(path: Path) -> Known:
    """What the file remembers; nothing where it is missing or damaged."""
    try:
        stored = read_json(path)
        return {
            name: (int(size), int(time), str(sha)) for name, (size, time, sha) in stored.items()
        }
    except (DataError, ValueError, TypeError, AttributeError):
        return {}
