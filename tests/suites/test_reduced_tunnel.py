"""The reduced form of suite tunnel runs whole, as a user would start it; a file of its own, to run beside others."""

from helpers.printed_rows import judged_in_reduced_form, processor_seconds, rows_of
from splatproof.suites.suite_files import load_suite

SHOWN = ("depth_abs_rel",)

MOST_SECONDS = 120.0
"""Processor seconds: the street and the tunnel together take less than four minutes, even one case
after the other. Measured: 14 at 112 pixels, beside other work; other processors take twice as long."""


def test_tunnel_runs_every_method(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["run", "tunnel", "--quick", "--out", str(tmp_path)], capsys)
    assert len(rows) == len(load_suite("tunnel-quick").cases)
    for row in rows:
        assert row["psnr"] > 10, row
        assert all(isinstance(row[name], float) for name in SHOWN), row
    assert processor_seconds(tmp_path) < MOST_SECONDS
    reasons = judged_in_reduced_form("tunnel", tmp_path, capsys)
    assert reasons["DLG-GS is above 3DGS"].startswith("1 seed; 3 are needed")
