"""The study of matched points: errors by hand, and the rows of its sweep."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from helpers.prior_scenes import plane_depth, plane_scene
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene, SparsePoints
from splatproof.suites.studies import matching


def on_the_plane(camera: Camera, factor: float) -> torch.Tensor:
    """Points through the middles of some pixels at a factor of their true depth."""
    depth = plane_depth(camera).double()
    row, column = torch.tensor([5, 9, 15]), torch.tensor([4, 12, 20])
    pixel = torch.stack([column + 0.5, row + 0.5, torch.ones(3)], dim=1).double()
    local = (torch.linalg.inv(camera.K) @ pixel.T).T * (factor * depth[row, column])[:, None]
    return (local - camera.translation) @ camera.rotation


def with_points(factors: list[float]) -> Scene:
    """The plane with three points a factor, all seen by view 1 alone."""
    scene = plane_scene()
    where = torch.cat([on_the_plane(scene.views[1].camera, factor) for factor in factors])
    return replace(
        scene,
        points=SparsePoints(
            positions=where, colours=torch.zeros(len(where), 3, dtype=torch.uint8),
            track_starts=torch.arange(len(where) + 1),
            track_views=torch.ones(len(where), dtype=torch.int64),
        ),
    )  # fmt: skip


def test_errors_are_shares_of_the_true_depth():
    scene = with_points([1.0, 1.1, 0.8])
    want = torch.tensor([0.0, 0.1, 0.2]).double().repeat_interleave(3)
    torch.testing.assert_close(matching.errors(scene), want, atol=1e-6, rtol=0)
    torch.testing.assert_close(matching.errors(scene, first=6), want[6:], atol=1e-6, rtol=0)


def test_what_no_view_sees_has_no_error():
    scene = with_points([1.0, -1.0])
    assert len(matching.errors(scene)) == 3
    assert len(matching.errors(replace(scene, train=()))) == 0


@pytest.mark.parametrize("roma", [None, Path("w")])
@pytest.mark.parametrize(("quick", "count"), [(True, 1 + 4 + 8), (False, 1 + 4 + 12)])
def test_each_matcher_and_threshold_is_changed_alone(monkeypatch, quick, count, roma):
    asked, priors = [], []

    def dense(scene, cell, image_bytes, settings):
        asked.append((len(scene.train), settings))
        return with_points([1.0, 1.2])

    monkeypatch.setattr(matching, "open_scene", lambda name, protocol: with_points([1.0]))
    monkeypatch.setattr(matching, "QUICK_VIEWS", 2)
    monkeypatch.setattr(matching, "with_dense_points", dense)
    monkeypatch.setattr(
        matching, "with_priors", lambda scene, prior, seed: priors.append(prior) or scene
    )
    rows = list(matching.rows(quick=quick, roma=roma))
    assert len(rows) == len(asked) == count + (roma is not None)
    usual = matching.DenseSettings()
    for row, (views, settings) in zip(rows, asked, strict=True):
        assert views == (2 if quick else 4)
        moved = {n: v for n, v in vars(settings).items() if v != getattr(usual, n)}
        if row.get("value") == "roma":
            assert moved == {"matcher": "roma", "weights": "w"}
        elif row.get("value") == "own":
            assert moved == {"matcher": "own"}
        elif row["threshold"] == "matcher":
            assert moved == {"matcher": "prior"}
        else:
            assert moved == (
                {} if row["threshold"] == "defaults" else {row["threshold"]: row["value"]}
            )
        assert row["points"] == 3
        assert row["median_error"] == pytest.approx(20, abs=1e-4)
        assert row["wrong"] == 100
    assert [row["value"] for row in rows[1:4]] == [f"prior {prior}" for prior in priors]
    assert priors == ["own", "sweep", "oracle"]
