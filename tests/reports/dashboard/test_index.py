"""What the dashboard keeps of a store: right, read once, and made anew where it is damaged."""

import dataclasses
import shutil
from pathlib import Path

import pytest

from helpers import case_folders, dashboard_store
from helpers.generated_store import write_store
from splatproof.base.errors import MissingError
from splatproof.reports.dashboard import index
from splatproof.reports.dashboard.cache import Cache
from splatproof.reports.dashboard.index import refreshed
from splatproof.reports.dashboard.listing import list_runs
from splatproof.reports.dashboard.numbers import short
from splatproof.reports.dashboard.site import Site
from splatproof.reports.dashboard.tables import POINTS, thinned
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.mlflow_client import open_client
from splatproof.reports.run_data import case_key
from splatproof.reports.store import complete_runs, read_history, read_results


def test_the_short_list_is_what_mlflow_says(store_uri: str):
    runs = complete_runs(open_client(store_uri))
    found = list_runs(store_uri)
    assert {one.run for one in found} == {run.info.run_id for run in runs}
    assert len(found) == len(list(dashboard_store.cases()))
    assert [one.ended for one in found] == sorted(run.info.end_time or 0 for run in runs)


def test_a_deleted_run_is_not_listed(store_uri: str, tmp_path: Path):
    shutil.copy(Path(store_uri.removeprefix("sqlite:///")), tmp_path / "mlflow.db")
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    gone = list_runs(uri)[0].run
    open_client(uri).delete_run(gone)
    assert gone not in {one.run for one in list_runs(uri)}


def test_a_file_that_is_no_store_is_refused(tmp_path: Path):
    (tmp_path / "mlflow.db").write_text("not a database, but long enough to be looked at\n" * 9)
    with pytest.raises(MissingError, match="cannot be read"):
        list_runs(f"sqlite:///{tmp_path}/mlflow.db")


def test_tables_and_newest_are_those_of_the_report(store_uri: str, site: Site):
    found = site.state.index
    stored = read_results(store_uri)
    assert [one.case for one in found.shown] == [case_key(one.result) for one in stored]
    tables = build_tables([one.result for one in stored])
    assert len(found.tables) == len(tables)
    for plain, table in zip(found.tables, tables, strict=True):
        rows = plain["brief"]["rows"]
        assert [row["label"] for row in rows] == [row.label for row in table.rows]
        assert [row["rank"] for row in rows] == [row.rank for row in table.rows]
        assert [row["note"] for row in rows] == [row.note for row in table.rows]
        first = table.columns[0].key
        for row, own in zip(rows, table.rows, strict=True):
            assert row["cells"].keys() == own.cells.keys()
            if first in own.cells:
                cell = own.cells[first]
                # six digits are kept
                assert row["cells"][first] == pytest.approx(
                    [cell.mean, cell.low, cell.high], rel=1e-5
                )


def test_every_run_is_there_not_the_newest_alone(store_uri: str, site: Site):
    found = site.state.index
    assert len(found.runs) == len(read_history(store_uri)) == 2 * 18 + 1
    assert len(found.shown) == 18 + 1


def test_a_refresh_reads_new_runs_alone(
    store_uri: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    cache = Cache(tmp_path / "kept")
    first = refreshed(store_uri, cache)
    read: list[str] = []

    def counted(uri: str, run: str, files: str):
        read.append(run)
        return true(uri, run, files)

    true = index.read_run
    monkeypatch.setattr(index, "read_run", counted)
    again = refreshed(store_uri, Cache(tmp_path / "kept"))
    assert read == []
    assert again == first
    with cache._connection as connection:
        forgotten = first.runs[0].run  # of the first commit: it is in no leaderboard
        connection.execute("DELETE FROM runs WHERE run = ?", (forgotten,))
    assert refreshed(store_uri, cache) == first
    assert read == [forgotten]


def test_a_leaderboard_is_computed_again_where_its_runs_are_others(store_uri: str, tmp_path: Path):
    cache = Cache(tmp_path / "kept")
    refreshed(store_uri, cache)
    shutil.copy(Path(store_uri.removeprefix("sqlite:///")), tmp_path / "mlflow.db")
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    slow = next(o for o in reversed(refreshed(uri, cache).shown) if o.numbers.row == "slow")
    open_client(uri).delete_run(slow.run)
    after = refreshed(uri, cache)
    runs = {run for t in after.tables for row in t["brief"]["rows"] for run in row["runs"]}
    assert slow.run not in runs


@pytest.mark.parametrize("damage", [b"", b"no database at all, whatever it was before " * 40])
def test_a_damaged_cache_is_made_anew(tmp_path: Path, damage: bytes):
    (tmp_path / "kept").write_bytes(damage)
    cache = Cache(tmp_path / "kept")
    assert cache.runs() == {}
    cache.keep_runs([("one", {})])
    assert Cache(tmp_path / "kept").runs() == {"one": "{}"}


def test_a_cache_that_cannot_be_written_is_told(tmp_path: Path):
    with pytest.raises(MissingError, match="--cache"):
        Cache(tmp_path / "absent" / "kept")


def test_a_cache_of_another_format_is_emptied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    cache = Cache(tmp_path / "kept")
    cache.keep_runs([("one", {})])
    cache.keep_derived("tables", "of", [1])
    assert Cache(tmp_path / "kept").runs() == {"one": "{}"}
    assert cache.derived("tables", "of") == [1]
    assert cache.derived("tables", "of others") is None
    monkeypatch.setattr("splatproof.reports.dashboard.cache.FORMAT", "another")
    assert Cache(tmp_path / "kept").runs() == {}


def test_an_empty_store_is_an_empty_index(migrated: Path, tmp_path: Path):
    shutil.copy(migrated, tmp_path / "mlflow.db")
    found = refreshed(f"sqlite:///{tmp_path}/mlflow.db", Cache(None))
    assert found == index.Index(runs=(), shown=(), tables=())


def test_a_generated_store_reads_as_the_cases_it_was_made_of(migrated: Path, tmp_path: Path):
    """The control of all that is measured on such stores: MLflow itself reads the same from them."""
    shutil.copy(migrated, tmp_path / "mlflow.db")
    cases = list(dashboard_store.cases())[:4]
    uri = write_store(tmp_path, cases)
    assert [one.result for one in read_history(uri)] == cases


def test_a_curve_keeps_its_clock_where_the_record_has_one():
    points = tuple((step, {"loss": 1 / step}) for step in range(1, 1001))
    clock = tuple(0.01 * step**1.2 for step in range(1, 1001))
    timed = dataclasses.replace(case_folders.result(), curve=points, curve_seconds=clock)
    columns = thinned(timed)
    assert len(columns["seconds"]) == len(columns["step"]) <= POINTS + 1
    assert columns["step"][-1] == 1000
    expected = [short(clock[step - 1]) for step in columns["step"]]
    assert columns["seconds"] == expected
    assert "seconds" not in thinned(dataclasses.replace(timed, curve_seconds=()))
