"""Suite files: which scenes, methods, protocols and seeds are to be run, as TOML."""

import dataclasses
import hashlib
import itertools
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splatproof.base.errors import UsageError
from splatproof.base.names import unknown
from splatproof.base.typed_toml import build, read_toml
from splatproof.methods.registry import methods
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import row_name

FOLDER = Path(__file__).parent / "definitions"
"""Where the suites that ship with the package lie."""
PATH = ("/", "./", "../")
"""What starts so is a path; everything else is a name, which may hold slashes."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """Cases that are a full product: every scene with every method, protocol and seed."""

    scenes: tuple[str, ...]
    """Registered names, or folders as "/...", "./..." or "../..." relative to the suite file."""
    methods: tuple[str, ...]
    """Names, or "method@variant" for a method that runs with several settings: a row each."""
    protocols: tuple[str, ...]
    """Names, or protocol files as "/...", "./..." or "../..." relative to the suite file."""
    seeds: tuple[int, ...] = (0,)
    settings: dict[str, dict[str, object]] = field(default_factory=dict)
    """Settings that differ from the defaults, by method and by "method@variant"; a variant has its
    method's too, and its own go first."""
    shared: dict[str, object] = field(default_factory=dict)
    """Settings that every row of the block has, unless `settings` says otherwise."""


@dataclass(frozen=True, kw_only=True)
class SuiteFile:
    """What a suite file holds, word by word."""

    description: str
    blocks: tuple[Block, ...]
    optional_scenes: tuple[str, ...] = ()
    """Scenes that are left out, with a said reason, where they are not on this machine."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One thing to run. Everything that its numbers depend on is here, apart from the data."""

    scene: str
    """As `open_scene` takes it: a registered name or an absolute folder."""
    method: str
    settings: Any
    """Instance of the method's settings dataclass."""
    variant: str = ""
    """What follows the "@", see Block; only the folder and the row's name depend on it."""
    seed: int
    protocol: Protocol

    @property
    def scene_name(self) -> str:
        """What results call the scene: its registered name or its folder's."""
        return Path(self.scene).name if self.scene.startswith(PATH) else self.scene

    @property
    def row(self) -> str:
        """What tables call it: method, or method@variant."""
        return row_name(self.method, self.variant)

    @property
    def folder(self) -> Path:
        """Relative folder of the case: <scene>/<row>/<protocol>/seed<k>."""
        return Path(self.scene_name, self.row, self.protocol.name, f"seed{self.seed}")

    @property
    def label(self) -> str:
        """What `--only` matches: scene/method/protocol/seed<k>."""
        return self.folder.as_posix()


@dataclass(frozen=True, kw_only=True)
class Suite:
    """The cases of a suite file."""

    name: str
    description: str
    cases: tuple[Case, ...]
    scenes: tuple[str, ...]
    """Names of all scenes that the file declares, also of those whose cases were left out."""
    optional_scenes: tuple[str, ...] = ()


def load_suite(name_or_path: str | Path) -> Suite:
    """The suite of that name (suites/<name>.toml) or in that file, every setting checked.

    Raises: UsageError naming the file, the key and the nearest name that exists.
    """
    path = _find(name_or_path)
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", path.stem):
        raise UsageError(f"{path}: the file's name becomes a folder; use letters, digits, '-', '_'")
    file = build(SuiteFile, read_toml(path), str(path))
    cases = [
        case
        for index, block in enumerate(file.blocks)
        for case in _cases(block, path, f"{path}: blocks[{index}]")
    ]
    _check_distinct(cases, path)
    unused = set(file.optional_scenes) - {scene for block in file.blocks for scene in block.scenes}
    if unused:
        raise UsageError(f"{path}: optional_scenes: no block has {', '.join(sorted(unused))}")
    return Suite(
        name=path.stem,
        description=file.description,
        cases=tuple(cases),
        scenes=tuple(dict.fromkeys(case.scene_name for case in cases)),
        optional_scenes=tuple(_beside(name, path) for name in file.optional_scenes),
    )


def suite_names() -> list[str]:
    """Names of the suites that ship with the package, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def quick_form(suite: str) -> str:
    """Name of the reduced form of a suite: SUITE-quick, a file beside it.

    Raises: UsageError for a suite that has none.
    """
    name = f"{suite}-quick"
    if not (FOLDER / f"{name}.toml").is_file():
        forms = sorted(path.stem.removesuffix("-quick") for path in FOLDER.glob("*-quick.toml"))
        raise UsageError(
            f"--quick: suite {suite!r} has no reduced form; studies have one, and "
            f"{', '.join(forms) or 'no suite'}"
        )
    return name


def case_key(case: Case, backend: str) -> str:
    """Hash of everything that a case's numbers depend on, apart from data, code and machine."""
    return key_of(
        scene=case.scene_name,
        method=case.method,
        settings=dataclasses.asdict(case.settings),
        seed=case.seed,
        protocol=dataclasses.asdict(case.protocol),
        backend=backend,
    )


def key_of(**parts: object) -> str:
    """SHA-256 of the parts as canonical JSON (sorted keys; tuples and lists are the same)."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _find(name_or_path: str | Path) -> Path:
    text = str(name_or_path)
    if text.endswith(".toml"):
        if Path(text).is_file():
            return Path(text)
        raise UsageError(f"{text}: no such suite file")
    path = FOLDER / f"{text}.toml"
    if "/" in text or not path.is_file():
        raise unknown("suite", text, suite_names())
    return path


def _cases(block: Block, path: Path, where: str) -> list[Case]:
    """The product of a block, scenes outermost so that a scene's rows fill one after the other."""
    for name in ("scenes", "methods", "protocols", "seeds"):
        if not getattr(block, name):
            raise UsageError(f"{where}.{name}: empty; a block needs at least one")
    if min(block.seeds) < 0:
        raise UsageError(f"{where}.seeds: expected whole numbers from 0, found {min(block.seeds)}")
    parts = {row: _parts(row, f"{where}.methods") for row in block.methods}
    known = {*parts, *(method for method, _ in parts.values())}
    for name in block.settings:
        if name not in known:
            raise unknown(f"{where}.settings", name, known)
    settings = {
        row: build(
            methods()[method].settings, _table(block, method, row), f"{where}.settings.{row}"
        )
        for row, (method, _) in parts.items()
    }
    protocols = [load_protocol(_beside(name, path)) for name in block.protocols]
    scenes = [_beside(name, path) for name in block.scenes]
    product = itertools.product(scenes, block.methods, protocols, block.seeds)
    return [
        Case(
            scene=scene, method=parts[row][0], settings=settings[row], variant=parts[row][1],
            seed=seed, protocol=protocol,
        )
        for scene, row, protocol, seed in product
    ]  # fmt: skip


def _parts(row: str, where: str) -> tuple[str, str]:
    """Method and variant of "method" or "method@variant"."""
    method, at, variant = row.partition("@")
    if method not in methods():
        raise unknown(where, method, methods())
    if at and not re.fullmatch(r"[\w.-]+", variant):
        raise UsageError(f"{where}: {row!r}; after '@' use letters, digits, '-', '_', '.'")
    return method, variant


def _table(block: Block, method: str, row: str) -> dict[str, Any]:
    """Settings of a row: what all rows share, then its method's, then its own."""
    own = block.settings.get(row, {}) if row != method else {}
    return merged(merged(block.shared, block.settings.get(method, {})), own)


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """One table of two: where both have a table it is merged too, else `above` wins."""
    both = dict(below)
    for key, value in above.items():
        mine = both.get(key)
        if isinstance(mine, Mapping) and isinstance(value, Mapping):
            both[key] = merged(mine, value)
        else:
            both[key] = value
    return both


def _beside(name: str, path: Path) -> str:
    """A path (it starts with "/", "./" or "../") relative to the suite file; a name as it is."""
    return str((path.parent / name).resolve()) if name.startswith(PATH) else name


def _check_distinct(cases: list[Case], path: Path) -> None:
    seen: set[str] = set()
    for case in cases:
        if case.label in seen:
            raise UsageError(f"{path}: the case {case.label} is there twice; its folder is one")
        seen.add(case.label)
