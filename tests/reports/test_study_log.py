"""Rows of a study in a tracking store."""

import math

from splatproof.reports.mlflow_client import open_client
from splatproof.reports.study_log import log_study, metric_name

ROW = {"component": "soft rank", "twin": "gsplat's own, 1", "case": "20 8x6", "ms": 1.5, "ok": True,
       "rms": math.inf, "pairs": 7, "none": None, "note": "text"}  # fmt: skip


def test_names_are_such_as_mlflow_takes():
    assert metric_name(ROW, "ms") == "soft rank/gsplat-s own- 1/20 8x6/ms"


def test_numbers_machine_and_files_arrive(tmp_path):
    uri = f"sqlite:///{tmp_path / 'mlflow.db'}"
    (tmp_path / "speed.jsonl").write_text("{}\n")
    files = [tmp_path / "speed.jsonl"]
    assert log_study("speed", {"cpu": "some", "gpu": ""}, [ROW], files, uri) == ""
    client = open_client(uri)
    experiment = client.get_experiment_by_name("splatproof/speed")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.data.metrics == {
        metric_name(ROW, "ms"): 1.5,
        metric_name(ROW, "pairs"): 7.0,
    }
    assert run.data.params == {"cpu": "some"}
    assert [file.path for file in client.list_artifacts(run.info.run_id)] == ["speed.jsonl"]


def test_a_store_that_is_away_is_told_in_one_line():
    said = log_study("speed", {}, [ROW], [], "nosuch://x")
    assert said
    assert "\n" not in said
