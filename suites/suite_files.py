"""Suite files: which scenes, methods, protocols and seeds are to be run, as TOML."""

import itertools
import math
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from splatproof.base.errors import UsageError
from splatproof.base.names import unknown
from splatproof.base.numbers import in_range
from splatproof.base.typed_toml import build, read_toml
from splatproof.datasets.catalogue.registry import list_scenes
from splatproof.datasets.pose_noise import LEVELS
from splatproof.methods.contracts.reconstruction import Origin
from splatproof.methods.priors.kinds import resolved
from splatproof.methods.registry import methods
from splatproof.metrics.protocol_files import load_protocol, resized
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import NO_PRIOR, TRUE_POSES, prior_name, row_name
from splatproof.reference.types.result_json import plain

FOLDER = Path(__file__).parent / "definitions"
"""Where the suites that ship with the package lie."""
MOST_CASES = 10_000
"""Cases of the largest suite: with seconds for the smallest case more take days."""
PATH = ("/", "./", "../")
"""What starts so is a path; everything else is a name, which may hold slashes."""


@dataclass(frozen=True, kw_only=True)
class CaseTable:
    """A table [[cases]]: every scene with every method under every protocol with every seed."""

    scenes: tuple[str, ...]
    """Registered names, or folders as "/...", "./..." or "../..." relative to the suite file."""
    methods: tuple[str, ...]
    """Names of methods, or "method@variant" where one runs with several settings: each variant has
    table rows of its own."""
    protocols: tuple[str, ...]
    """Registered names, or protocol files as "/...", "./..." or "../..." relative to the suite file."""
    seeds: tuple[int, ...] = (0,)
    """Numbers from 0 on which every random draw of a case depends."""
    pose_noise: tuple[str, ...] = (TRUE_POSES,)
    """Levels of noise on the poses of training views, drawn with the case's seed; see
    `splatproof.datasets.pose_noise`. Each level has table rows of its own."""
    depth_prior: tuple[str, ...] = (NO_PRIOR,)
    """Depth priors of training views: "none", or kinds of `splatproof.methods.priors.kinds`, of
    which some take the path of their weights, relative to the suite file ("network:net.safetensors").
    Each has table rows of its own."""
    marks: tuple[float, ...] = ()
    """Wall seconds, rising, after which the model is kept as it is then and scored too: time to quality.
    Seconds count from the opening of the scene. For methods that do not train in blocks."""
    width: int | None = None
    """Width of the images in pixels, in training and in scoring, as `bench run --width` has it; the
    protocols' names then say so. None: the protocols' own."""
    settings: dict[str, dict[str, object]] = field(default_factory=dict)
    """Settings that differ from the defaults, by method and by "method@variant"; a variant has those
    of its method too, and where both name a setting the variant's own holds."""
    shared: dict[str, object] = field(default_factory=dict)
    """Settings that every case of this table has, unless `settings` says otherwise."""


@dataclass(frozen=True, kw_only=True)
class SuiteFile:
    """What a suite file holds, word by word."""

    description: str
    """What the suite is for."""
    cases: tuple[CaseTable, ...]
    optional_scenes: tuple[str, ...] = ()
    """Scenes that are left out, with a said reason, where they are not on this machine."""
    means: bool = True
    """Whether reports give means over the scenes; False where the scenes have nothing in common."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One thing to run. Everything that its numbers depend on is here, apart from the data."""

    scene: str
    """Registered name or absolute folder of the scene, as `open_scene` takes it."""
    method: str
    """Name of the method."""
    settings: Any
    """Instance of the method's settings dataclass."""
    variant: str = ""
    """What follows the "@", see CaseTable; only the folder and the name in tables depend on it."""
    seed: int
    protocol: Protocol
    pose_noise: str = TRUE_POSES
    """Level of the noise on the poses of training views."""
    depth_prior: str = NO_PRIOR
    """Depth prior of the training views; a path in it is absolute."""
    marks: tuple[float, ...] = ()
    """Wall seconds after which the model is scored as it is then, see CaseTable."""

    @property
    def scene_name(self) -> str:
        """What results call the scene: its registered name or its folder's."""
        return Path(self.scene).name if self.scene.startswith(PATH) else self.scene

    @property
    def row(self) -> str:
        """What tables call it; see `row_name`."""
        return row_name(self.method, self.variant, self.pose_noise, prior_name(self.depth_prior))

    @property
    def origin(self) -> Origin:
        """Where a model of this case comes from, as it is saved with it."""
        return Origin(
            method=self.method, variant=self.variant, settings=asdict(self.settings),
            scene=self.scene, protocol=asdict(self.protocol), seed=self.seed,
            pose_noise=self.pose_noise, depth_prior=prior_name(self.depth_prior),
        )  # fmt: skip

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
    """Names of all scenes that the file declares, also of those whose cases were left out. A mean
    over scenes is given only where all of them are there; empty: no mean is wanted."""
    optional_scenes: tuple[str, ...] = ()


def check_settings(method: str, settings: object) -> None:
    """Refuse settings that a record cannot hold.

    Args:
        method: Name of the method.
        settings: Instance of its settings dataclass.
    Raises: UsageError naming method and setting.
    """
    try:
        plain(settings, "settings")
    except TypeError as error:
        raise UsageError(
            f"method {method}: {error}; settings are numbers, text, None, and dataclasses, tuples and "
            "tables of these"
        ) from None


def load_suite(name_or_path: str | Path) -> Suite:
    """Read a suite file and check every setting in it.

    Args:
        name_or_path: Name of a suite that ships with the package, or the path of a .toml file.
    Returns: The suite with all its cases.
    Raises: UsageError naming the file, the key and the nearest name that exists.
    """
    path = _find(name_or_path)
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", path.stem):
        raise UsageError(f"{path}: the file's name becomes a folder; use letters, digits, '-', '_'")
    file = build(SuiteFile, read_toml(path), str(path))
    if not file.cases:
        raise UsageError(f"{path}: cases: empty; expected at least one table [[cases]]")
    cases = [
        case
        for index, table in enumerate(file.cases)
        for case in _cases(table, path, f"{path}: cases[{index}]")
    ]
    _check_distinct(cases, path)
    unused = set(file.optional_scenes) - {scene for table in file.cases for scene in table.scenes}
    if unused:
        raise UsageError(
            f"{path}: optional_scenes: {min(unused)} is among the scenes of no table [[cases]]; "
            "add it to one or leave it out here"
        )
    return Suite(
        name=path.stem,
        description=file.description,
        cases=tuple(cases),
        scenes=tuple(dict.fromkeys(case.scene_name for case in cases)) if file.means else (),
        optional_scenes=tuple(_beside(name, path) for name in file.optional_scenes),
    )


def suite_names() -> list[str]:
    """Names of the suites that ship with the package, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def quick_form(suite: str) -> str:
    """Name of the reduced form of a suite: SUITE-quick, a file beside it.

    Args:
        suite: Name of the whole suite.
    Returns: Name of the reduced one.
    Raises: UsageError for a suite that has none.
    """
    name = f"{suite}-quick"
    if not (FOLDER / f"{name}.toml").is_file():
        forms = sorted(path.stem.removesuffix("-quick") for path in FOLDER.glob("*-quick.toml"))
        raise UsageError(
            f"--quick: suite {suite!r} has no reduced form; there is one of "
            f"{', '.join(forms) or 'no suite'}"
        )
    return name


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


def _cases(table: CaseTable, path: Path, where: str) -> list[Case]:
    """The product of a table, scenes outermost so that each scene is finished before the next."""
    for name in ("scenes", "methods", "protocols", "seeds", "pose_noise", "depth_prior"):
        if not getattr(table, name):
            raise UsageError(f"{where}.{name}: empty; expected at least one")
    lists = (table.scenes, table.methods, table.protocols, table.pose_noise, table.depth_prior)
    count = math.prod(map(len, (*lists, table.seeds)))
    in_range(count, f"{where}: the number of cases", 1, MOST_CASES)
    if min(table.seeds) < 0:
        raise UsageError(f"{where}.seeds: expected whole numbers from 0, found {min(table.seeds)}")
    if table.width is not None and table.width < 1:
        raise UsageError(f"{where}.width: expected pixels, 1 or more, found {table.width}")
    if list(table.marks) != sorted({mark for mark in table.marks if 0 < mark < math.inf}):
        raise UsageError(f"{where}.marks: expected seconds above 0, rising, found {table.marks}")
    for level in table.pose_noise:
        if level not in LEVELS:
            raise unknown(f"{where}.pose_noise", level, LEVELS)
    priors = [resolved(name, path.parent, f"{where}.depth_prior") for name in table.depth_prior]
    parts = {row: _parts(row, f"{where}.methods") for row in table.methods}
    known = {*parts, *(method for method, _ in parts.values())}
    for method, _ in parts.values() if table.marks else ():
        if methods()[method].blocks:
            raise UsageError(
                f"{where}.marks: {method} trains blocks in processes of their own, which are one model "
                "only at the end; leave marks out"
            )
    for name in table.settings:
        if name not in known:
            raise unknown(f"{where}.settings", name, known)
    settings = {
        row: build(
            methods()[method].settings, _settings(table, method, row), f"{where}.settings.{row}"
        )
        for row, (method, _) in parts.items()
    }
    for row, (method, _) in parts.items():
        check_settings(method, settings[row])
    protocols = [
        resized(_protocol(name, path, f"{where}.protocols"), table.width)
        for name in table.protocols
    ]
    scenes = [_scene(name, path, f"{where}.scenes") for name in table.scenes]
    product = itertools.product(
        scenes, table.methods, protocols, table.pose_noise, priors, table.seeds
    )
    return [
        Case(
            scene=scene, method=parts[row][0], settings=settings[row], variant=parts[row][1],
            seed=seed, protocol=protocol, pose_noise=level, depth_prior=prior, marks=table.marks,
        )
        for scene, row, protocol, level, prior, seed in product
    ]  # fmt: skip


def _protocol(name: str, path: Path, where: str) -> Protocol:
    """A registered protocol, or that of a file. Raises: UsageError that names the suite file too."""
    try:
        return load_protocol(_beside(name, path))
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None


def _parts(row: str, where: str) -> tuple[str, str]:
    """Method and variant of "method" or "method@variant"."""
    method, at, variant = row.partition("@")
    if method not in methods():
        raise unknown(where, method, methods())
    if at and not re.fullmatch(r"[\w.-]+", variant):
        raise UsageError(f"{where}: {row!r}; after '@' use letters, digits, '-', '_', '.'")
    return method, variant


def _settings(table: CaseTable, method: str, row: str) -> dict[str, Any]:
    """Settings of "method@variant": what all share, then the method's, then the variant's own."""
    own = table.settings.get(row, {}) if row != method else {}
    return merged(merged(table.shared, table.settings.get(method, {})), own)


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Join two TOML tables; where both have a table under one key, those are joined too.

    Args:
        below: Values that hold where `above` says nothing.
        above: Values that hold in any case.
    Returns: A new table.
    """
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


def _scene(name: str, path: Path, where: str) -> str:
    """A registered name or an absolute folder.

    Raises: UsageError for a folder beside the suite file or here that is written like a name.
    """
    if not name.startswith(PATH) and name not in {entry.name for entry in list_scenes()}:
        for folder, meant in (
            (path.parent / name, f"./{name}"),
            (Path(name), str(Path(name).resolve())),
        ):
            if os.path.isdir(folder):  # a name that no folder can have is none
                raise UsageError(
                    f"{where}: {name!r} is a folder and no registered scene; a folder is written with "
                    f"'./', '../' or '/' in front, relative to the suite file: {meant!r}"
                )
    return _beside(name, path)


def _check_distinct(cases: list[Case], path: Path) -> None:
    seen: set[str] = set()
    for case in cases:
        if case.label in seen:
            raise UsageError(
                f"{path}: the case {case.label} is there twice and would have one folder. Where two "
                f"runs of {case.method} differ in settings, name them apart in `methods`, as "
                f'"{case.method}@one" and "{case.method}@two" with a table of settings each '
                f'([cases.settings."{case.method}@two"]); tables show them as rows of their own. '
                "Else remove one"
            )
        seen.add(case.label)
