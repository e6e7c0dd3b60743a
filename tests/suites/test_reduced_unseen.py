"""The reduced form of suite unseen runs whole, as a user would start it; a file of its own, to run beside others."""

import json

from helpers.printed_rows import judged_in_reduced_form, rows_of
from splatproof.suites.suite_files import load_suite


def test_unseen_runs_every_row(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(
        ["run", "unseen", "--quick", "--engine", "inline", "--out", str(tmp_path)], capsys
    )
    assert len(rows) == len(load_suite("unseen-quick").cases)
    assert all(row["psnr"] > 9 for row in rows)
    (own,) = [row for row in rows if row["variant"] == "own"]
    facts = json.loads((tmp_path / "unseen-quick" / own["folder"] / "record.json").read_text())
    said = json.dumps(facts)
    assert "out of domain: trained on city, aerial-sparse, used on courtyard" in said
    reasons = judged_in_reduced_form("unseen", tmp_path, capsys)
    assert any(reason.startswith("1 seed; 3 are needed") for reason in reasons.values())
