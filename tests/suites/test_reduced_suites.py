"""The reduced forms of the long suites run whole, as a user would start them."""

import pytest

from helpers.printed_rows import judged_in_reduced_form, rows_of
from splatproof.suites.hard_cases import steps
from splatproof.suites.studies import ladders, stability
from splatproof.suites.suite_files import load_suite

SEAMS = tuple(f"{name}_partition" for name in ("seam_psnr", "bpd_l1", "nbgj", "seam_coverage"))


@pytest.mark.needs_scene("brighton_beach")
def test_city_compares_every_row_on_a_real_scene(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["run", "city", "--quick", "--engine", "inline", "--out", str(tmp_path)], capsys)
    assert len(rows) == len(load_suite("city-quick").cases)
    for row in rows:
        assert row["psnr"] > 10  # a black image has 6.5, a grey one 13
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


def test_a_part_of_study_stability_passes_in_its_reduced_form(tmp_path, capsys, monkeypatch):
    """All ladders, cases of Gaussians and steps of methods, and every eighth of the other cases.

    `test_studies.py` judges each of these by itself.
    """
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    for module, name in ((stability, "CASES"), (stability, "RISING")):
        monkeypatch.setattr(module, name, getattr(module, name)[::8])
    rows = rows_of(["study", "stability", "--quick", "--out", str(tmp_path)], capsys)
    found = {row["component"] for row in rows}
    assert found >= {"rasterizer", steps.COMPONENT, stability.CASES[0].component}
    assert found >= {ladders.LADDERS[-1].component, stability.RISING[-1].component}
    assert all(row["ok"] for row in rows)
    assert list(tmp_path.rglob("stability.png"))


# every twin in a process of its own, each with all imports: a minute; every ladder has a panel in a picture
@pytest.mark.slow
@pytest.mark.parametrize("study", ["stability", "speed"])
def test_studies_pass_in_their_reduced_form(study: str, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    rows = rows_of(["study", study, "--quick", "--out", str(tmp_path)], capsys)
    assert rows
    assert all(row["ok"] for row in rows)
