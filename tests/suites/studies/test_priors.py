"""The study of depth priors: what a good one, a warped one and a wrong one get, and the picture."""

from dataclasses import replace

import cv2
import pytest
import torch
from torch.testing import assert_close

from helpers.prior_scenes import plane_scene
from splatproof.methods.priors.oracle import prior_of
from splatproof.reference.types.scene import DepthPrior, View
from splatproof.suites.studies import priors


def viewed(disparity: torch.Tensor, valid: torch.Tensor | None = None) -> View:
    """A view of the plane with this prior."""
    view = plane_scene().views[1]
    known = torch.ones_like(disparity, dtype=torch.bool) if valid is None else valid
    return replace(view, load_prior=lambda: DepthPrior(disparity=disparity, valid=known))


@pytest.fixture
def truth() -> torch.Tensor:
    load = plane_scene().views[1].load_depth
    assert load is not None
    return prior_of(load()).disparity


def test_scale_and_zero_do_not_count_but_order_does(truth):
    row = priors.view_row(viewed(5 * truth + 3))
    assert_close(torch.tensor([row["abs_rel"], row["rank"], row["valid"]]),
                 torch.tensor([0.0, 1.0, 1.0]), rtol=0, atol=1e-4)  # fmt: skip
    wrong = priors.view_row(viewed(-truth))
    assert wrong["rank"] < -0.99
    bent = priors.view_row(viewed(truth**3))
    assert 0.005 < bent["abs_rel"] < 0.2
    assert bent["rank"] > 0.999


def test_what_is_not_valid_does_not_count(truth):
    spoilt, valid = truth.clone(), torch.ones_like(truth, dtype=torch.bool)
    spoilt[:, :8], valid[:, :8] = 9.0, False
    row = priors.view_row(viewed(spoilt, valid))
    assert row["abs_rel"] < 1e-4
    assert row["valid"] == pytest.approx(2 / 3)
    assert priors.view_row(viewed(truth, ~valid & valid)) == {}


def test_rows_and_picture(monkeypatch, tmp_path):
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path))
    monkeypatch.setattr(
        priors, "open_scene", lambda name, protocol: replace(plane_scene(), name=name)
    )
    rows = list(priors.rows(quick=True))
    by = {row["prior"]: row for row in rows}
    assert by["oracle"]["abs_rel"] < 1e-6 < by["oracle+noise"]["abs_rel"]
    assert by["lidar"]["abs_rel"] < 0.01
    assert "no two training views" in by["sweep"]["note"]
    assert {row["scene"] for row in rows} == {"street"}
    (path,) = priors.draw(rows, tmp_path)
    picture = cv2.imread(str(path))
    assert picture is not None
    assert picture.std() > 20
