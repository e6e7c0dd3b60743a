"""The reduced forms of the long suites run whole, as a user would start them."""

import pytest

from helpers.printed_rows import judged_in_reduced_form, rows_of
from splatproof.suites.suite_files import load_suite

SEAMS = ("seam_psnr", "bpd_l1", "nbgj", "seam_coverage")


@pytest.mark.needs_scene("brighton_beach")
def test_city_compares_every_row_on_a_real_scene(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["run", "city", "--quick", "--engine", "inline", "--out", str(tmp_path)], capsys)
    assert len(rows) == len(load_suite("city-quick").cases)
    for row in rows:
        assert row["psnr"] > 10  # a grey image has less
        if row["method"] != "3dgs":
            assert all(isinstance(row[name], float) for name in SEAMS), row
            assert min(row[f"{stage}_peak_mb"] for stage in ("blocks", "stitch", "score")) > 50
            assert row["over_hard_cut"] >= 1  # a hard cut, or sis, which drops nothing of it
    reasons = judged_in_reduced_form("city", tmp_path, capsys)
    assert reasons["refinement (GCR) raises SSIM"].startswith("1 seed; 3 are needed")


@pytest.mark.slow  # both methods run whole in street's reduced form
def test_anchors_stand_beside_gaussians(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["run", "anchors", "--quick", "--out", str(tmp_path)], capsys)
    assert {row["method"] for row in rows} == {"3dgs", "scaffold-gs"}
    assert all(row["psnr"] > 10 for row in rows)
    reasons = judged_in_reduced_form("anchors", tmp_path, capsys)
    assert all("1 seed; 3 are needed" in r or "not been run" in r for r in reasons.values())


# every twin in a process of its own, each with all imports: a minute
@pytest.mark.parametrize("study", ["stability", pytest.param("speed", marks=pytest.mark.slow)])
def test_studies_pass_in_their_reduced_form(study: str, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["study", study, "--quick", "--out", str(tmp_path)], capsys)
    assert rows
    assert all(row["ok"] for row in rows)
