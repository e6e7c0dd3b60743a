"""The reduced form of suite sparse runs whole, as a user would start it; a file of its own, to run beside others."""

import json

from helpers.printed_rows import judged_in_reduced_form, rows_of
from splatproof.suites.suite_files import load_suite


def test_sparse_runs_every_method(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["run", "sparse", "--quick", "--out", str(tmp_path)], capsys)
    assert len(rows) == len(load_suite("sparse-quick").cases)
    assert all(row["psnr"] > 8 for row in rows)
    (own,) = [row for row in rows if row["depth_prior"] == "own"]
    facts = json.loads((tmp_path / "sparse-quick" / own["folder"] / "record.json").read_text())
    assert "in domain: trained on courtyard, city, used on courtyard" in json.dumps(facts)
    reasons = judged_in_reduced_form("sparse", tmp_path, capsys)
    assert any(reason.startswith("1 seed; 3 are needed") for reason in reasons.values())
