"""Crops: the views that changed most, cut where their error changed most."""

import dataclasses

import cv2
import numpy as np

from helpers.compared_sides import drawn_pair
from splatproof.reports.comparing.compare import compare
from splatproof.reports.comparing.crops import changed_views, draw, place
from splatproof.reports.comparing.sides import Side

SPOT = np.s_[70:90, 20:50]


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def with_pictures(side: Side, grey: int) -> Side:
    """Pictures of 120 x 160: a grey truth; the render has another grey in a spot."""
    truth = np.full((120, 160, 3), 128, np.uint8)
    render = truth.copy()
    render[SPOT] = grey

    def read(kind: str, image: str, /) -> bytes:
        return png(truth if kind == "truth" else render)

    cases = tuple(dataclasses.replace(case, pictures=read) for case in side.cases)
    return dataclasses.replace(side, cases=cases)


def test_worse_views_come_first_and_none_twice():
    base, new = drawn_pair(0, -1.0)
    for case in new.cases[:3]:
        case.measured.images["view_5"]["psnr"] -= 0.2 + 0.1 * (case.measured.seed == 1)
    views = changed_views(compare(base, new, metrics=["psnr"], bands={}))
    shown = [(v.compared.group.scene, v.image) for v in views]
    worst = views[shown.index(("scene_0", "view_5"))]
    assert worst.new.measured.seed == worst.base.measured.seed
    assert worst.change == min(view.change for view in views)
    assert len({(v.compared.group.name, v.image) for v in views}) == len(views) <= 6
    assert all(v.compared.verdict == "worse" for v in views)


def test_without_anything_worse_the_largest_changes_are_shown():
    views = changed_views(compare(*drawn_pair(0), bands={}))
    assert views
    assert not changed_views(compare(drawn_pair(0)[0], drawn_pair(0)[0], bands={}))


def test_the_crop_lies_where_the_error_rose():
    base, new = drawn_pair(0, -1.0)
    found = compare(with_pictures(base, 128), with_pictures(new, 220), bands={})
    change = np.zeros((120, 160))
    change[SPOT] = 0.4
    change[0:10, 100:160] = -0.4
    top, left, side = place(change, found.compared[0])
    assert side == 48
    assert top <= 70
    assert top + side >= 90
    assert left <= 20
    assert left + side >= 50


def test_the_sheet_shows_the_change():
    base, new = drawn_pair(0, -1.0)
    view = changed_views(compare(with_pictures(base, 128), with_pictures(new, 220), bands={}))[0]
    drawn = draw(view)
    assert isinstance(drawn, bytes)
    decoded = cv2.imdecode(np.frombuffer(drawn, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    sheet = decoded.astype(int)
    blue, green, red = sheet[..., 0], sheet[..., 1], sheet[..., 2]
    strong = (red - blue > 100) & (red - green > 100)
    assert strong[:, -240:].sum() > 2000  # the error rose: red, in the last panel
    assert not strong[:, : -2 * 240].any()
    assert view.image in view.title


def test_a_side_without_pictures_is_told():
    base, new = drawn_pair(0, -1.0)
    views = changed_views(compare(base, with_pictures(new, 200), bands={}))
    assert draw(views[0]) == f"BASE has no pictures of {views[0].base.name}"
