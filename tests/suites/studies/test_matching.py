"""The study of matched points: errors by hand, and the rows of its sweep."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from helpers.prior_scenes import plane_depth, plane_scene
from splatproof.cli.study import read_rows
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene, SparsePoints
from splatproof.suites.studies import matching, matching_page


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
    monkeypatch.setattr(matching, "SCENES", ("here", "there"))
    monkeypatch.setattr(matching, "chosen_pairs", lambda scene, settings: [(0, 1), (1, 0)])
    rows = list(matching.rows(quick=quick, roma=roma))
    of_one = count + (roma is not None)
    assert len(rows) == len(asked) == of_one * (1 if quick else 2)
    assert [row["scene"] for row in rows] == ["here"] * of_one + ["there"] * (len(rows) - of_one)
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
        assert (row["points"], row["pairs"], row["points_a_pair"]) == (3, 2, 1.5)
        assert row["median_error"] == pytest.approx(20, abs=1e-4)
        assert row["wrong"] == 100
    assert [row["value"] for row in rows[1:4]] == [f"prior {prior}" for prior in priors[:3]]
    assert priors == ["own", "sweep", "oracle"] * (1 if quick else 2)
    known = [
        row.get("domain", "") for row in rows[:5]
    ]  # the plane is no world that a network was trained on
    assert [text.partition(":")[0] for text in known] == [
        "",
        "out of domain",
        "",
        "",
        "out of domain",
    ]


def test_the_page_has_each_threshold_in_order_with_its_default_among_them():
    usual = matching.DenseSettings()
    rows = [
        {"scene": "s", "threshold": "defaults", "pairs": 4, "points": 6, "points_a_pair": 1.5, "seconds": 1.0},
        {"scene": "s", "threshold": "matcher", "value": "own", "domain": "in domain: trained on s, used on s",
         "pairs": 4, "points": 8, "points_a_pair": 2.0, "median_error": 0.25, "wrong": 1.0, "seconds": 1.0},
        {"scene": "s", "threshold": "partners", "value": 8, "pairs": 9, "points": 7, "seconds": 1.0},
        {"scene": "s", "threshold": "partners", "value": 1, "pairs": 2, "points": 5, "seconds": 1.0},
    ]  # fmt: skip
    text = matching_page.page({"cpu": "abacus"}, rows, [])
    assert "| `own`: our matching network | in domain | 4 | 8 | 2.0 | 0.250 | 1.00 | 1.0 |" in text
    assert "| optical flow (the default) |  | 4 | 6 | 1.5 | – | – | 1.0 |" in text
    part = text.split("partners of a photo")[1]
    assert [part.index(f"| {cell} |") for cell in ("1", f"**{usual.partners}**", "8")] == sorted(
        part.index(f"| {cell} |") for cell in ("1", f"**{usual.partners}**", "8")
    )
    assert "abacus" in text


def test_the_committed_page_is_made_of_the_committed_rows():
    docs = Path(__file__).parents[3] / "docs"
    machine, rows = read_rows(docs / "matching.json")
    assert matching_page.page(machine, rows, []) == (docs / "matching.md").read_text(
        encoding="utf-8"
    )
    assert {row["scene"] for row in rows} == set(matching.SCENES)
