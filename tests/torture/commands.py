"""The commands that are killed, what they need, and what they must leave behind in the end."""

import json
import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from helpers import case_folders
from helpers.aerial_photos import write_flight
from helpers.colmap_scenes import Flight, write_scene
from helpers.tiny_scene import random_gaussians
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.reference.types.result import Result
from splatproof.reference.types.result_json import result_from_json
from splatproof.reports.mlflow_search import STATE

SUITE = """description = "Killed"
[[cases]]
scenes = ["./town"]
methods = ["3dgs"]
protocols = ["default"]
seeds = [0, 1]
[cases.settings.3dgs]
iterations = 150
"""
CHECKPOINTS = ("--checkpoint-seconds", "0.3")
EXPORTED = ("a.ply", "a.spgs", "a.glb", "a.spz", "a.sog")
UNSTABLE = re.compile(r"\b[0-9a-f]{32}\b|\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d)?")
"""Names of a store's runs, which it draws, and hours."""
PICTURES = ("renders", "truth", "errors")


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command of bench, run in a folder of its own."""

    arguments: tuple[str, ...]
    program: tuple[str, ...] = ()
    """What is run with the arguments; empty: bench."""
    prepare: Callable[[Path], None]
    """Makes what the command reads."""
    outcome: Callable[[Path], dict[str, object]]
    """What must be equal in the end, by name; works on a folder in which nothing was done too."""
    whole: tuple[str, ...] = ()
    """Names of files and folders that are there whole or not at all, at any moment."""


def _town(folder: Path) -> None:
    write_scene(folder / "town", Flight(points=40))
    (folder / "mine.toml").write_text(SUITE)


def _photos(folder: Path) -> None:
    write_flight(folder / "photos", size=(320, 240))


def _model(folder: Path) -> None:
    save_model(ExplicitModel(model=random_gaussians(60_000, degree=2)), folder / "model", Origin())


def _cases(folder: Path) -> None:
    list(case_folders.suite(folder / "out", seeds=2))


def contents(*names: str) -> Callable[[Path], dict[str, object]]:
    """Bytes of files, and of all files of folders."""

    def outcome(folder: Path) -> dict[str, object]:
        roots = [folder / name for name in names]
        files = [
            path for root in roots for path in (root, *sorted(root.rglob("*"))) if path.is_file()
        ]
        return {str(path.relative_to(folder)): path.read_bytes() for path in files}

    return outcome


def essence(result: Result) -> Result:
    """The result without what depends on the clock and the machine."""
    return replace(
        result, stages={}, cpu_seconds=0.0, peak_memory_mb=0.0, render_ms=0.0, environment={},
        curve_seconds=(),
    )  # fmt: skip


def trained(name: str) -> Callable[[Path], dict[str, object]]:
    """Records, model bytes, pictures and the rows of the store in a folder of runs."""

    def outcome(folder: Path) -> dict[str, object]:
        out = folder / name
        found: dict[str, object] = {}
        for path in sorted(out.rglob("record.json")):
            if "mlartifacts" not in path.parts:
                found[str(path.relative_to(out))] = essence(
                    result_from_json(path.read_text(), str(path))
                )
        for path in sorted(out.rglob("*")):
            parts = path.relative_to(out).parts
            if "mlartifacts" not in parts and {"model", *PICTURES} & set(parts) and path.is_file():
                found["/".join(parts)] = path.read_bytes()
        return found | _store(out)

    return outcome


def _store(out: Path) -> dict[str, object]:
    """Records of the complete runs in a store, and how many there are.

    MLflow keeps a connection to every path that it was asked for, and here each round's is the same.
    """
    with closing(sqlite3.connect(f"file:{out / 'mlflow.db'}?mode=ro", uri=True)) as connection:
        rows = connection.execute(
            "SELECT run_uuid FROM tags WHERE key = ? AND value = 'complete'", (STATE,)
        ).fetchall()
    results = [
        result_from_json((out / "mlartifacts" / run / "artifacts/record.json").read_text(), run)
        for (run,) in rows
    ]
    found: dict[str, object] = {"rows": len(rows)}
    return found | {f"row of {r.scene} {r.method} {r.seed}": essence(r) for r in results}


def _reported(folder: Path) -> dict[str, object]:
    """The board, the page without its hour and its runs' names, and the rows of the store."""
    out = folder / "out"
    page = UNSTABLE.sub("", (out / "report.html").read_text())
    return {"board": (folder / "board.md").read_text(), "page": page} | _store(out)


def _rows(name: str) -> Callable[[Path], dict[str, object]]:
    """Rows of a study without what they took."""

    def outcome(folder: Path) -> dict[str, object]:
        path = folder / name
        rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
        return {
            f"{name} {i}": {k: v for k, v in row.items() if k != "ms"} for i, row in enumerate(rows)
        }

    return outcome


COMMANDS: dict[str, Command] = {
    "ingest": Command(
        arguments=("ingest", "photos", "scene", "--threads", "1"), prepare=_photos, outcome=contents("scene"), whole=("scene",),
    ),
    "fit": Command(
        arguments=("fit", "3dgs", "town", "--iterations", "150", "--out", "out", *CHECKPOINTS),
        prepare=_town, outcome=trained("out"),
    ),
    "run": Command(
        arguments=("run", "mine.toml", "--out", "out", *CHECKPOINTS), prepare=_town, outcome=trained("out"),
    ),
    "scenes make": Command(
        arguments=("scenes", "make", "courtyard", "yard"), prepare=lambda folder: None,
        outcome=contents("yard"), whole=("yard",),
    ),
    "export": Command(
        arguments=("export", "model", "--ply", "a.ply", "--packed", "a.spgs", "--gltf", "a.glb", "--spz", "a.spz",
                   "--sog", "a.sog"),
        prepare=_model, outcome=contents(*EXPORTED), whole=EXPORTED,
    ),
    "report": Command(
        arguments=("report", "--out", "out", "--markdown", "board.md"), prepare=_cases, outcome=_reported,
    ),
    "study": Command(
        arguments=("study", "memory", "--quick", "--out", "out"), prepare=lambda folder: None,
        outcome=_rows("out/memory.jsonl"),
    ),
}  # fmt: skip
