"""Published rows of a paper's suite, with the reasons why ours are or are not comparable to them.

numbers.csv has the printed values of the tables of five papers, one a line. The columns `note` say
what was inferred and what looks like a slip. <suite>.toml says which rows belong to which scenes of
that suite, what the suite does otherwise than the paper, and where the paper contradicts itself.
"""

import csv
import functools
from dataclasses import dataclass, field
from pathlib import Path

from splatproof.base.errors import DataError, UsageError
from splatproof.base.names import unknown
from splatproof.base.typed_toml import build, read_toml

FOLDER = Path(__file__).parent
NUMBERS = FOLDER / "numbers.csv"
COLUMNS = (
    "paper", "table", "method", "variant", "dataset", "scene", "metric", "value", "unit",
    "higher_is_better", "note",
)  # fmt: skip
SUSPECT = "extraction suspect"
"""How the note of a value begins that is not to be compared with anything."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Which published rows a scene of the suite stands for."""

    dataset: str
    """As in numbers.csv."""
    scene: str = ""
    """As in numbers.csv; "" for the mean over the data set."""
    tables: tuple[str, ...] = ()
    """Tables whose rows are meant; empty: all that have the scene."""
    variant: str = ""
    """What the variant of the rows must contain, where a table has several protocols."""
    differs: tuple[str, ...] = ()
    """What the suite's case does otherwise than the paper; empty together with the suite's
    `differs`: comparable."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """A paper beside the suite that reruns it."""

    paper: str
    """As in numbers.csv."""
    title: str
    scenes: dict[str, Place]
    """Scene of the suite, or a pattern's set name with "*", to its published rows."""
    differs: tuple[str, ...]
    """What every case of the suite does otherwise, or the paper does not say."""
    unavailable: tuple[str, ...] = ()
    """Parts of the tables that nobody else can run, and why."""
    contradictions: tuple[str, ...] = ()
    """Where the paper's numbers contradict each other or its text, with the places."""


@dataclass(frozen=True, kw_only=True)
class PublishedRow:
    """A method's row of a table."""

    method: str
    variant: str
    table: str
    values: dict[str, str] = field(default_factory=dict)
    """Metric to the value as printed."""
    notes: tuple[str, ...] = ()
    suspect: bool = False
    """At least one value looks like a slip of print or extraction."""


def published_suites() -> list[str]:
    """Names of the suites that rerun a paper."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load_published(suite: str) -> Published:
    """The paper behind a suite.

    Raises: UsageError for a suite without one, or a file that does not fit.
    """
    path = FOLDER / f"{suite}.toml"
    if suite not in published_suites():
        raise unknown("published numbers of suite", suite, published_suites())
    return build(Published, read_toml(path), str(path))


def reasons(published: Published, scene: str) -> tuple[str, ...]:
    """Why a result of that scene is not comparable with the paper's; empty: it is.

    Args:
        published: Numbers and conditions of one paper.
        scene: Name of the suite's scene.
    """
    return (*published.differs, *published.scenes[scene].differs)


def rows_of(published: Published, scene: str) -> list[PublishedRow]:
    """The published rows that stand beside a scene of the suite, in the paper's order.

    Args:
        published: Numbers and conditions of one paper.
        scene: Name of the suite's scene.

    Raises: UsageError for a scene that the paper's file does not have.
    """
    if scene not in published.scenes:
        raise UsageError(f"{published.paper}: no published row belongs to {scene!r}")
    place = published.scenes[scene]
    found: dict[tuple[str, str, str], PublishedRow] = {}
    for line in numbers():
        if (
            line["paper"] != published.paper
            or (line["dataset"], line["scene"]) != (place.dataset, place.scene)
            or (place.tables and line["table"] not in place.tables)
            or place.variant not in line["variant"]
        ):
            continue
        key = (line["table"], line["method"], line["variant"])
        row = found.setdefault(
            key, PublishedRow(method=line["method"], variant=line["variant"], table=line["table"])
        )
        note = line["note"]
        found[key] = PublishedRow(
            method=row.method,
            variant=row.variant,
            table=row.table,
            values=row.values | {line["metric"]: line["value"]},
            notes=row.notes if not note or note in row.notes else (*row.notes, note),
            suspect=row.suspect or note.startswith(SUSPECT),
        )
    return list(found.values())


@functools.cache
def numbers() -> tuple[dict[str, str], ...]:
    """Every published value, as in numbers.csv. Raises: DataError if the file is damaged."""
    with NUMBERS.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise DataError(f"{NUMBERS}: has columns {reader.fieldnames}, expected {COLUMNS}")
        return tuple(reader)
