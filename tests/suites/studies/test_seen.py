"""The study of what training photos show: rows of a plane whose answer is known, and the picture."""

from dataclasses import replace

import cv2
import pytest

from helpers.flat_ground import FOCAL, GROUND, WIDTH, flat_scene
from splatproof.base.errors import MissingError
from splatproof.datasets.seen_split import seen_split
from splatproof.suites.studies import seen


def test_flat_ground_is_seen_alike_by_points_and_in_truth():
    row = seen.scene_row(flat_scene(0.0, 3.0))
    assert row["seen_in_truth"] == pytest.approx(1 - FOCAL * 3.0 / GROUND / WIDTH, abs=1 / WIDTH)
    assert row["called_unseen_wrongly"] == 0
    assert row["called_seen_wrongly"] == pytest.approx(row["seen_by_points"] - row["seen_in_truth"])
    assert row["called_seen_wrongly"] < 0.25 * FOCAL * 3.0 / GROUND / WIDTH


def test_without_true_depth_the_points_alone_speak():
    row = seen.scene_row(seen.without_depth(flat_scene(0.0, 3.0)))
    assert row.keys() == {"views", "seen_by_points"}


def test_the_rule_holds_out_what_is_seen(monkeypatch):
    def opened(_, rules):
        scene = flat_scene(-9.0, -3.0, 0.0, 3.0, 6.0, 7.0, 8.0, 9.0)
        train, test = (scene.train, scene.test)
        if rules.least_seen:
            train, test = seen_split(scene.views, scene.points, rules)
        return replace(scene, train=train, test=test)

    monkeypatch.setattr(seen, "open_scene", opened)
    row = seen.rule_row("flat", "quick")
    assert row["least_seen"] < 0.7
    assert row["views_by_rule"] == 1
    assert seen.LEAST <= row["least_by_rule"] == row["seen_by_rule"]
    assert seen.rule_row("flat", "street") == {}


def test_a_scene_that_is_not_here_is_noted(monkeypatch, tmp_path):
    def absent(*_):
        raise MissingError("courtyard: not on this machine")

    monkeypatch.setattr(seen, "open_scene", absent)
    (row,) = seen.rows(quick=True)
    assert row["note"] == "courtyard: not on this machine"
    assert not seen.draw([row], tmp_path)


def test_the_picture_shows_what_is_not_seen_in_red(tmp_path, monkeypatch):
    monkeypatch.setattr(seen, "open_scene", lambda *_: flat_scene(0.0, 3.0))
    (path,) = seen.draw([{"scene": "plane", "protocol": "quick"}], tmp_path)
    picture = cv2.imread(str(path))
    assert picture is not None
    picture = picture.astype(int)
    assert ((picture[..., 2] > picture[..., 1] + 60).mean()) > 0.02
