"""The reduced forms of the long suites run whole, as a user would start them."""

import json

import pytest

from helpers.real_scenes import real_scene
from splatproof.cli import main
from splatproof.suites.suite_files import load_suite

SEAMS = ("seam_psnr", "bpd_l1", "nbgj", "seam_coverage")


def rows_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> list[dict]:
    """What a command that succeeds prints for machines."""
    assert main([*arguments, "--json", "--quiet"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_city_compares_every_row_on_a_real_scene(tmp_path, capsys, monkeypatch):
    real_scene("brighton_beach")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["run", "city", "--quick", "--out", str(tmp_path)], capsys)
    assert len(rows) == len(load_suite("city-quick").cases)
    for row in rows:
        assert row["psnr"] > 10  # a grey image has less
        if row["method"] != "3dgs":
            assert all(isinstance(row[name], float) for name in SEAMS), row


@pytest.mark.parametrize(
    ("suite", "shown"),
    [("street", ("moving_psnr", "still_psnr", "depth_abs_rel")), ("tunnel", ("depth_abs_rel",))],
)
def test_street_and_tunnel_run_every_method(suite, shown, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["run", suite, "--quick", "--out", str(tmp_path)], capsys)
    assert len(rows) == len(load_suite(f"{suite}-quick").cases)
    for row in rows:
        assert row["psnr"] > 10, row
        assert all(isinstance(row[name], float) for name in shown), row


@pytest.mark.parametrize("study", ["stability", "speed"])
def test_studies_pass_in_their_reduced_form(study: str, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["study", study, "--quick", "--out", str(tmp_path)], capsys)
    assert rows
    assert all(row["ok"] for row in rows)
