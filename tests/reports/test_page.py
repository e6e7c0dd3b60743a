"""The page without a browser: it stands alone, says what must be said, and keeps its size."""

import base64
import dataclasses
import datetime
import json
import math
import re
from html.parser import HTMLParser
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers import case_folders
from splatproof.base.errors import DataError
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import Result
from splatproof.reports import charts, pictures
from splatproof.reports import page as report_page
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.page import render_page
from splatproof.reports.store import StoredResult
from splatproof.reports.text import explained

WHEN = datetime.datetime(2026, 1, 2, 3, 4, tzinfo=datetime.UTC)


class WithoutPictures(StoredResult):
    """A result whose pictures are not asked for from any store."""

    def picture(self, kind: str, image: str) -> bytes | None:
        del kind, image
        return None


def page(results: list[Result], **named: Any) -> str:
    stored = [WithoutPictures(one, "sqlite:///x.db", str(i)) for i, one in enumerate(results)]
    return render_page(build_tables(results), stored, "sqlite:///x.db", WHEN, **named)


def of_store(stored: list[StoredResult], **named: Any) -> str:
    tables = build_tables([one.result for one in stored])
    return render_page(tables, stored, stored[0].uri, WHEN, **named)


@pytest.fixture(scope="module")
def whole(stored: list[StoredResult]) -> str:
    """The page of the store, which tests read and none changes."""
    return of_store(stored)


class Reader(HTMLParser):
    """Elements with what they refer to; fails on elements that are not closed in order."""

    VOID = frozenset({"meta", "link", "img", "input", "wbr"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.ids: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.elements.append((tag, named))
        self.references += [named[key] or "" for key in ("src", "href", "srcset") if key in named]
        self.ids += [named["id"] or ""] if "id" in named else []
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def embedded(text: str) -> dict[str, str]:
    found = re.search(r'id="pictures">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


def test_it_refers_to_nothing_outside_itself(whole: str):
    text = whole
    read = Reader(text)
    assert all(ref.startswith(("#", "data:")) for ref in read.references)
    assert {ref[1:] for ref in read.references if ref.startswith("#")} <= set(read.ids)
    assert len(read.ids) == len(set(read.ids))
    assert "@import" not in text
    assert "url(" not in text
    assert "default-src 'none'" in text
    assert all(uri.startswith("data:image/jpeg;base64,") for uri in embedded(text).values())


def test_it_shows_every_row_and_every_image(stored: list[StoredResult], whole: str):
    text = whole
    words = " ".join(Reader(text).words)
    for table in build_tables([one.result for one in stored]):
        for row in table.rows:
            assert row.label in words
            assert table.columns[0].with_interval(row.cells["psnr"]) in words
        for heading, about in explained([table]).items():
            assert about in words, heading
    assert all(name in words for name in case_folders.NAMES)
    assert "dji_0003.jpg" in words
    assert "not registered: 4 matches" in words
    assert "Error map: FLIP" in words
    # two scenes of four images: a truth that three methods share, and their renders and errors
    assert len(embedded(text)) == 2 * 4 * (1 + 3 * 2)


def test_a_few_differences_and_their_verdicts_are_open_and_many_are_not(
    stored: list[StoredResult], whole: str, monkeypatch: pytest.MonkeyPatch
):
    def shown(text: str) -> list[bool]:
        parts = text.split("<details")[1:]
        return [part.startswith(" open>") for part in parts if "Differences between" in part]

    assert shown(whole)
    assert all(shown(whole))
    monkeypatch.setattr(report_page, "OPEN_DIFFERENCES", 1)
    assert not any(shown(of_store(stored)))


def test_it_is_the_same_twice(stored: list[StoredResult], whole: str):
    assert of_store(stored) == whole


def test_the_budget_of_pictures_holds_and_the_page_says_so(stored: list[StoredResult], whole: str):
    size = sum(map(len, embedded(whole).values()))
    text = of_store(stored, budget=size // 2)
    assert sum(map(len, embedded(text).values())) <= size // 2
    assert "of 4 test images are embedded" in text
    least = of_store(stored, budget=1)
    assert len(embedded(least)) == 2 * (1 + 3 * 2)  # one image a scene whatever it takes
    assert "1 of 4 test images are embedded" in least


def test_names_from_outside_are_escaped():
    evil = "<script>alert(1)</script>"
    result = dataclasses.replace(
        case_folders.result(method=evil, scene=evil, names=[evil + ".jpg"]),
        left_out=((evil, evil),),
        environment={"machine": evil},
        scene_facts={evil: evil},
    )
    text = page([result, *(dataclasses.replace(result, seed=s) for s in (1, 2))])
    assert evil not in text
    assert len([tag for tag, _ in Reader(text).elements if tag == "script"]) == 3


def test_warnings_failures_and_undefined_values_are_said():
    good = [case_folders.result(seed=seed) for seed in range(3)]
    other = dataclasses.replace(good[0], method="b", split_sha256="0", render_ms=math.nan)
    failed = dataclasses.replace(good[0], method="c", error="out of memory", images=(), metrics={})
    words = " ".join(Reader(page([*good, other, failed])).words)
    assert "the training images differ" in words
    assert "c: unranked: 0 seeds; seed 0 failed: out of memory" in words
    assert "1 failed case" in words
    assert "nan" not in words


def test_every_set_of_rules_is_listed_even_under_one_name():
    one = Protocol(name="same", source="ours", metrics=("psnr",), rounding="round")
    two = dataclasses.replace(one, rounding="truncate")
    words = Reader(page([case_folders.result(protocol=rules) for rules in (one, two)])).words
    assert {"round", "truncate"} <= set(words)
    assert words.count("Protocol same") == 2


def test_a_page_of_failures_alone_is_a_page():
    failed = dataclasses.replace(
        case_folders.result(), error="boom", images=(), metrics={}, curve=()
    )
    assert "boom" in page([failed])


def test_passwords_of_the_store_are_not_shown():
    results = [case_folders.result()]
    stored = [WithoutPictures(results[0], "", "0")]
    text = render_page(build_tables(results), stored, "http://me:secret@host/x", WHEN)
    assert "secret" not in text
    assert "http://host/x" in text


@settings(deadline=None, max_examples=50)
@given(count=st.integers(0, 200))
def test_spread_is_an_order_of_all_that_starts_with_the_ends(count: int):
    order = pictures.spread(count)
    assert sorted(order) == list(range(count))
    assert set(order[:2]) == {0, count - 1} if count else order == []
    for taken in (5, 9, 17):
        if count >= taken:
            gaps = np.diff(sorted(order[:taken]))
            assert gaps.max() <= math.ceil((count - 1) / (taken - 1)) * 2


def test_pictures_are_scaled_down_and_stay_what_they_are():
    truth = case_folders.photo("a", 300, 2000)
    png = cv2.imencode(".png", truth)[1].tobytes()
    data = base64.b64decode(pictures.encode(png, "a").partition(",")[2])
    back = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert back is not None
    assert back.shape == (144, pictures.WIDEST, 3)
    want = cv2.resize(
        np.clip(truth, 0, 255).round(), (pictures.WIDEST, 144), interpolation=cv2.INTER_AREA
    )
    # JPEG at quality 90 without subsampling: a quantisation step or two on average
    assert np.abs(back.astype(float) - want).mean() < 3


def test_a_damaged_picture_is_named():
    with pytest.raises(DataError, match=r"town render of a\.jpg: not an image"):
        pictures.encode(b"no picture", "town render of a.jpg")


@settings(deadline=None, max_examples=100)
@given(low=st.floats(-1e6, 1e6), span=st.floats(1e-3, 1e6))
def test_ticks_are_few_round_and_inside(low: float, span: float):
    found = charts.ticks(low, low + span)
    assert 1 <= len(found) <= 7
    room = 1e-6 * span + 1e-9 * abs(low)
    assert all(low - room <= tick <= low + span + room for tick in found)
    assert np.allclose(np.diff(found), np.diff(found)[:1]) if len(found) > 1 else True


def test_charts_leave_out_what_is_not_finite():
    nothing = charts.scatter([charts.Point("a", 0, math.nan, 1.0, 0.9, 1.1)], "x", "y")
    assert nothing == ""
    assert charts.lines([charts.Line("a", 0, [(0.0, math.inf), (1.0, 2.0)])], "x", "y") == ""
    flat = charts.lines([charts.Line("a", 0, [(0.0, 2.0), (1.0, 2.0), (2.0, math.nan)])], "x", "y")
    assert "nan" not in flat
    assert flat.count("<polyline") == 1


def test_long_curves_are_thinned_and_keep_their_ends():
    points = [(float(i), float(i)) for i in range(100_000)]
    drawn = re.search(r'points="([^"]*)"', charts.lines([charts.Line("a", 0, points)], "x", "y"))
    assert drawn
    corners = drawn[1].split()
    assert len(corners) <= charts.MOST_POINTS + 1
    whole = charts.lines([charts.Line("a", 0, [points[0], points[-1]])], "x", "y")
    ends = re.search(r'points="([^"]*)"', whole)
    assert ends
    assert [corners[0], corners[-1]] == ends[1].split()


def test_chart_text_is_escaped():
    point = charts.Point("<b>&", 0, 1.0, 2.0, math.nan, math.nan)
    assert "<b>" not in charts.scatter([point], "<x>", "<y>")


def test_the_page_is_small_without_pictures():
    results = [
        case_folders.result(seed=seed, names=[f"{i:04}.jpg" for i in range(500)])
        for seed in range(3)
    ]
    assert len(page(results)) < 400_000
