"""A large MLflow store without a run: real case folders of small records, and rows in its tables.

MLflow logs about ten runs a second, so ten thousand are written into its tables as one real run left
them there. What readers see is the same.
"""

import dataclasses
import shutil
import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path

import numpy as np

from helpers import case_folders
from splatproof.reference.types.result import ImageScore, Result
from splatproof.reference.types.result_json import result_to_json
from splatproof.reports import run_data
from splatproof.reports.store import EXPERIMENTS, sync

METRICS = ("psnr", "ssim_3dgs", "lpips", "flip")
RUNS_EVERY = 60_000
"""Milliseconds between the ends of two runs."""
START = 1_780_000_000_000
Write = Callable[[Path, Result], object]


def record_alone(folder: Path, case: Result) -> None:
    """Write a case's record and nothing else.

    Args:
        folder: Its folder, which is made.
        case: The case.
    """
    folder.mkdir(parents=True)
    (folder / "record.json").write_text(result_to_json(case), encoding="utf-8")


def write_store(out: Path, cases: Iterable[Result], write: Write = record_alone) -> str:
    """A store that has these cases, as if they had ended a minute after one another.

    Args:
        out: Folder of the store; an empty migrated store may lie there.
        cases: From the oldest to the newest, of any suites.
        write: Writes the files of a case into a folder.
    Returns: Its tracking URI.
    """
    uri = f"sqlite:///{out}/mlflow.db"
    model = out / "model_case"
    record_alone(model, case_folders.result())
    assert sync([model], uri) == []
    shutil.rmtree(model)
    with closing(sqlite3.connect(out / "mlflow.db")) as connection:
        connection.row_factory = sqlite3.Row
        with connection:
            _fill(connection, out, cases, write)
    return uri


def large_store(
    out: Path, *, scenes: int, rows: int, seeds: int, images: int, suites: int = 1
) -> str:
    """A store of suites x scenes x rows x seeds runs with as many images each as is asked for.

    Args:
        out: Empty folder, or one with an empty migrated store.
        scenes: Scenes of each suite.
        rows: Methods of each scene.
        seeds: Seeds of each method.
        images: Scored images of each run.
        suites: Suites, with the same scenes' names.
    Returns: Its tracking URI.
    """
    return write_store(out, _results(scenes, rows, seeds, images, suites))


def _fill(connection: sqlite3.Connection, out: Path, cases: Iterable[Result], write: Write) -> None:
    """Put the cases in the place of the one real run."""
    run = dict(connection.execute("SELECT * FROM runs").fetchone())
    experiment = dict(connection.execute(
        "SELECT * FROM experiments WHERE name LIKE ?", (f"{EXPERIMENTS}%",)).fetchone())  # fmt: skip
    tables = ("metrics", "latest_metrics", "params", "tags")
    pattern = {t: [dict(r) for r in connection.execute(f"SELECT * FROM {t}")] for t in tables}
    for table in (*tables, "runs"):
        connection.execute(f"DELETE FROM {table}")
    numbers: dict[str, int] = {}
    for place, result in enumerate(cases):
        if result.suite not in numbers:
            numbers[result.suite] = experiment["experiment_id"] + len(numbers)
            own = experiment | {
                "experiment_id": numbers[result.suite], "name": EXPERIMENTS + result.suite,
            }  # fmt: skip
            _insert(connection, "experiments", [own], replace=True)
        name = f"{place:032x}"
        folder = out / "mlartifacts" / name / "artifacts"
        write(folder, result)
        ends = START + place * RUNS_EVERY
        row = {
            "run_uuid": name, "name": run_data.case_name(result), "artifact_uri": folder.as_uri(),
            "start_time": ends - 40_000, "end_time": ends, "experiment_id": numbers[result.suite],
        }  # fmt: skip
        _insert(connection, "runs", [run | row])
        for table in tables:
            _insert(connection, table, [one | {"run_uuid": name} for one in pattern[table]])


def _insert(
    connection: sqlite3.Connection, table: str, rows: list[dict], replace: bool = False
) -> None:
    if not rows:
        return
    names = ", ".join(rows[0])
    marks = ", ".join("?" * len(rows[0]))
    verb = "INSERT OR REPLACE" if replace else "INSERT"
    connection.executemany(
        f"{verb} INTO {table} ({names}) VALUES ({marks})", [tuple(row.values()) for row in rows]
    )


def _results(scenes: int, rows: int, seeds: int, images: int, suites: int):
    """Results with plausible numbers: harder and easier images, better and worse methods."""
    names = [f"view_{i:04d}.png" for i in range(images)]
    towns = tuple(f"town_{i:02d}" for i in range(scenes))
    for suite in range(suites):
        for scene in towns:
            base = case_folders.result(scene=scene, names=names)
            for row in range(rows):
                for seed in range(seeds):
                    yield _result(base, f"suite_{suite}", f"method-{row:02d}", seed, towns)


def _result(base: Result, suite: str, method: str, seed: int, towns: tuple[str, ...]) -> Result:
    rng = case_folders.generator(suite, base.scene, method, seed)
    shift = 2 * case_folders.generator(method).normal() + rng.normal(0, 0.05)
    hard = np.array([image.metrics["psnr"] for image in base.images])
    psnr = hard + shift + rng.normal(0, 0.1, len(hard))
    scores = {
        "psnr": psnr, "ssim_3dgs": 1 - 4 / psnr, "lpips": 6 / psnr, "flip": 3.5 / psnr,
    }  # fmt: skip
    own = tuple(
        ImageScore(name=image.name, truth_sha256=image.truth_sha256, valid_share=1.0,
                   metrics={name: float(scores[name][i]) for name in METRICS})
        for i, image in enumerate(base.images)
    )  # fmt: skip
    return dataclasses.replace(
        base, suite=suite, method=method, seed=seed, images=own, suite_scenes=towns,
        metrics={name: float(scores[name].mean()) for name in METRICS},
        render_ms=float(10 + 20 * rng.random()), bytes_on_disk=int(4e6 * (1 + rng.random())),
    )  # fmt: skip
