"""What MLflow's own pages have to show: nested runs, descriptions, data sets and saved views."""

import dataclasses
import json
import os
import shutil
import signal
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from helpers import case_folders
from helpers.forked import ended, forked
from splatproof.reference.types.result import Result
from splatproof.reports import executions
from splatproof.reports.mlflow_client import open_client
from splatproof.reports.mlflow_search import EXECUTION, EXPERIMENTS, STATE
from splatproof.reports.saved_views import SCORES, VIEW
from splatproof.reports.shown_run import NOTE, PARENT
from splatproof.reports.store import find_cases, read_results, sync


@pytest.fixture
def uri(migrated: Path, tmp_path: Path) -> str:
    shutil.copy(migrated, tmp_path / "mlflow.db")
    return f"sqlite:///{tmp_path / 'mlflow.db'}"


def write(out: Path, **changes: Any) -> Path:
    case = case_folders.result(**changes)
    return case_folders.write_case(out, dataclasses.replace(case, suite_scenes=("town",)), 6, 8)


def experiment(uri: str) -> Any:
    found = open_client(uri).get_experiment_by_name(EXPERIMENTS + "quick")
    assert found is not None
    return found


def runs(uri: str) -> tuple[list[Any], list[Any]]:
    """Runs of executions, and runs of cases."""
    found = list(open_client(uri).search_runs([experiment(uri).experiment_id]))
    parents = [run for run in found if EXECUTION in run.data.tags]
    return parents, [run for run in found if EXECUTION not in run.data.tags]


def state(uri: str, view: str) -> dict[str, Any]:
    return json.loads(json.loads(experiment(uri).tags[VIEW + view])["state"])


def test_cases_lie_below_their_execution_and_readers_do_not_see_it(tmp_path: Path, uri: str):
    folders = [write(tmp_path, seed=seed) for seed in range(2)]
    assert sync(folders, uri) == []
    (parent,), cases = runs(uri)
    assert {case.data.tags[PARENT] for case in cases} == {parent.info.run_id}
    assert parent.info.run_name == "quick 0123abc"
    assert parent.info.status == "FINISHED"
    assert parent.info.start_time == min(case.info.start_time for case in cases)
    assert parent.info.end_time == max(case.info.end_time for case in cases)
    assert [one.result.seed for one in read_results(uri)] == [0, 1]


def test_a_later_sync_adds_to_the_execution_and_another_commit_is_another(tmp_path: Path, uri: str):
    sync([write(tmp_path, seed=0)], uri)
    sync([write(tmp_path, seed=1, error="it broke")], uri)
    ((parent,), _) = runs(uri)
    assert parent.info.status == "FAILED"
    assert "2 cases, 1 failed" in parent.data.tags[NOTE]
    assert "seed1: it broke" in parent.data.tags[NOTE]
    sync([write(tmp_path, seed=2, environment={"commit": "fedcba9876"})], uri)
    parents, cases = runs(uri)
    assert sorted(one.info.run_name for one in parents) == ["quick 0123abc", "quick fedcba9"]
    assert len(cases) == 3


def test_the_description_of_an_execution_has_the_means_over_seeds(tmp_path: Path, uri: str):
    folders = [write(tmp_path, seed=seed, metrics={"psnr": 20.0 + seed}) for seed in range(2)]
    sync(folders, uri)
    ((parent,), _) = runs(uri)
    assert "| town | ours_250 | 3dgs | 2 | 20.5000 |" in parent.data.tags[NOTE]


def test_a_case_that_no_suite_ran_lies_alone(tmp_path: Path, uri: str):
    folder = write(tmp_path, seed=0).rename(tmp_path / "my_fit")
    assert sync([folder], uri) == []
    parents, (case,) = runs(uri)
    assert parents == []
    assert PARENT not in case.data.tags


def test_two_processes_make_one_execution(tmp_path: Path, uri: str):
    for seed in range(4):
        write(tmp_path, seed=seed)

    def work(order: int) -> None:
        assert sync(find_cases(tmp_path)[::order], uri) == []

    both = [forked(partial(work, order)) for order in (1, -1)]
    assert [ended(pid) for pid in both] == [0, 0]
    (parent,), cases = runs(uri)
    assert len(cases) == 4
    assert {case.data.tags[PARENT] for case in cases} == {parent.info.run_id}


def test_an_execution_whose_sync_was_killed_is_finished_by_the_next(tmp_path: Path, uri: str):
    """Every case is in the store then, so that nothing else is left to do."""
    folder = write(tmp_path, seed=0)

    def die(*_: object, **__: object) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def work() -> None:
        executions.finish = die
        sync([folder], uri)

    assert ended(forked(work)) == -signal.SIGKILL
    ((half,), _) = runs(uri)
    assert half.info.status == "RUNNING"
    assert NOTE not in half.data.tags
    assert sync([folder], uri) == []
    ((whole,), cases) = runs(uri)
    assert (whole.info.run_id, whole.info.status) == (half.info.run_id, "FINISHED")
    assert NOTE in whole.data.tags
    assert len(cases) == 1


def test_source_version_and_description_of_a_run(tmp_path: Path, uri: str):
    sync([write(tmp_path, seed=0)], uri)
    _, (case,) = runs(uri)
    tags = case.data.tags
    assert tags["mlflow.source.name"] == "bench run quick"
    assert tags["mlflow.source.git.commit"] == "0123abc"
    assert "bench run quick --only town/3dgs/ours_250/seed0" in tags[NOTE]
    assert f"| psnr | {case.data.metrics['psnr']:.4f} |" in tags[NOTE]


def test_the_data_set_changes_with_the_scenes_files_alone(tmp_path: Path, uri: str):
    facts = {"photos_sha256": "1", "pillow": "13"}
    changes = [{}, {"pillow": "14"}, {"photos_sha256": "2"}]
    folders = [write(tmp_path, seed=i, scene_facts=facts | c) for i, c in enumerate(changes)]
    sync(folders, uri)
    _, cases = runs(uri)
    inputs = {case.data.params["seed"]: case.inputs.dataset_inputs[0] for case in cases}
    assert inputs["0"].dataset.name == "town"
    assert inputs["0"].tags[0].value == "ours_250"
    digests = {seed: one.dataset.digest for seed, one in inputs.items()}
    assert digests["0"] == digests["1"] != digests["2"]


def test_the_view_of_scores_has_what_differs_and_the_metrics_that_rank(tmp_path: Path, uri: str):
    folders = [
        write(tmp_path, seed=0, settings={"iterations": 100, "sh_degree": 3}),
        write(tmp_path, seed=1, method="slow", settings={"iterations": 900, "sh_degree": 3}),
    ]
    sync(folders, uri)
    view = state(uri, SCORES)
    assert view["selectedColumns"][:6] == [
        "metrics.`psnr`", "metrics.`ssim_3dgs`",
        "params.`scene`", "params.`row`", "params.`seed`", "params.`settings.iterations`",
    ]  # fmt: skip
    assert view["columnOrder"][1:] == view["selectedColumns"]
    assert (view["orderByKey"], view["orderByAsc"]) == ("metrics.`psnr`", False)
    shown = set(view["selectedColumns"])
    client = open_client(uri)
    found = client.search_runs([experiment(uri).experiment_id], view["searchFilter"])
    assert {run.data.tags[STATE] for run in found} == {"complete"}
    for run in found:  # every column is there
        names = {f"params.`{name}`" for name in run.data.params}
        assert shown <= names | {f"metrics.`{name}`" for name in run.data.metrics}


def test_a_description_that_a_user_wrote_stays_and_nothing_is_written_twice(
    tmp_path: Path, uri: str, monkeypatch: pytest.MonkeyPatch
):
    folder = write(tmp_path, seed=0)
    sync([folder], uri)
    client = open_client(uri)
    client.set_experiment_tag(experiment(uri).experiment_id, NOTE, "mine")
    monkeypatch.setattr(type(client), "set_experiment_tag", lambda *_: pytest.fail("written"))
    sync([folder], uri)
    assert experiment(uri).tags[NOTE] == "mine"


def before(folder: Path, uri: str) -> Result:
    """A run as it was logged when runs had neither parents nor data sets."""
    sync([folder], uri)
    client = open_client(uri)
    (parent,), (case,) = runs(uri)
    client.delete_run(parent.info.run_id)
    client.delete_tag(case.info.run_id, PARENT)
    return read_results(uri)[0].result


def test_a_store_from_before_is_read_and_added_to(tmp_path: Path, uri: str):
    old = before(write(tmp_path, seed=0), uri)
    assert old.seed == 0
    write(tmp_path, seed=1)
    assert sync(find_cases(tmp_path), uri) == []
    assert [one.result.seed for one in read_results(uri)] == [0, 1]
    (parent,), _ = runs(uri)
    assert "2 cases" in parent.data.tags[NOTE]
