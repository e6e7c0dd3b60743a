"""The pages of the street, the tunnel, few views and anchors: made of the committed rows, and every part of them by hand."""

import json
import math
from dataclasses import fields as fields_of
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from comparison_files import page, planned
from comparison_page import ANCHORED, Page, render_page
from kept_rows import Picture, contradicts, joined, pictures_of, plain
from make_anchors_page import ANCHORS
from make_sparse_page import SPARSE
from make_street_page import STREET
from make_tunnel_page import TUNNEL
from make_unseen_page import UNSEEN
from printed_tables import Line, Printed, ours, printed_tables, printed_value
from strips import SHARE, VIEWS, WIDTH, crops, strip

from helpers.tiny_scene import tiny_scene
from splatproof.methods.registry import methods
from splatproof.reports.claims.claim import Claim, load_claims
from splatproof.reports.claims.obstacles import method_of
from splatproof.reports.measured import Measured
from splatproof.suites.published.rows import numbers
from splatproof.suites.suite_files import load_suite, suite_names

DOCS = Path(__file__).parents[2] / "docs"
BOTH = pytest.mark.parametrize(
    "made", [STREET, TUNNEL, SPARSE, ANCHORS, UNSEEN], ids=lambda one: one.suite
)


@BOTH
def test_the_committed_page_is_what_the_generator_makes_of_the_committed_rows(made):
    assert (DOCS / f"{made.suite}.md").read_text(encoding="utf-8") == page(made, DOCS)


@BOTH
def test_every_picture_of_the_page_is_there_and_small(made):
    shown = json.loads((DOCS / f"{made.suite}_pictures.json").read_text(encoding="utf-8"))
    for entry in shown:
        assert (DOCS / entry["path"]).stat().st_size < 150_000


@cache
def rows_of(suite: str) -> set[str]:
    return {row for _, _, row in planned(load_suite(suite).cases)}


@BOTH
def test_claims_and_printed_tables_name_rows_of_the_suite(made):
    rows = {(row, protocol) for _, protocol, row in planned(load_suite(made.suite).cases)}
    named = {row for row, _ in rows}
    for claim in load_claims(made.suite, numbers()):
        if not claim.missing and {method_of(row) for row in claim.rows} <= set(methods()):
            assert {claim.row, claim.other} <= rows_of(claim.suite), claim.text
            both = {protocol for row, protocol in rows if row in (claim.row, claim.other)}
            assert claim.protocol in both or len(both) == 1, claim.text
    assert {line.row for table in made.printed for line in table.lines} <= named
    assert made.protocol in {protocol for _, protocol in rows}


@BOTH
def test_printed_tables_are_printed(made):
    for table in made.printed:
        for line in table.lines:
            values = [printed_value(table, line, metric) for metric in table.metrics]
            assert not any(map(math.isnan, values)), (table.title, line)


@BOTH
def test_other_forms_have_the_rows_of_the_suite(made):
    """The reduced form runs a row of every method; the page names the medium one where there is one."""
    whole = load_suite(made.suite).cases
    quick = load_suite(f"{made.suite}-quick").cases
    assert {case.method for case in quick} == {case.method for case in whole}
    named = f"`bench run {made.suite}-medium` is the larger scene" in page(made, DOCS)
    assert named == (f"{made.suite}-medium" in suite_names())


@BOTH
def test_rows_that_were_run_in_parts_are_joined_in_the_order_of_the_suite(made):
    cases = load_suite(made.suite).cases
    every = [
        {"scene": c.scene_name, "protocol": c.protocol.name, "row": c.row, "seed": c.seed, "n": 0}
        for c in cases
    ]  # fmt: skip
    assert joined(every, [], cases) == (every, 0)
    new = [{**one, "n": 1} for one in every[1::2]]
    gone = {**every[0], "row": "no-longer-planned"}
    rows, kept = joined(new[::-1], [*every[::-1], gone], cases)
    assert kept == len(every) - len(new)
    assert [one["n"] for one in rows] == [index % 2 for index in range(len(every))]
    assert [{**one, "n": 0} for one in rows] == every
    more = {**every[0], "seed": 99}  # --seeds may ask for more than the suite does
    assert more in joined(every, [more], cases)[0]


def test_a_committed_row_of_other_settings_is_dropped():
    case, *_ = (one for one in load_suite("unseen").cases if one.row == "dpgs")
    place = {"scene": "city", "protocol": "unseen", "row": "dpgs", "seed": 0}
    now = plain(case)
    older = {name: value for name, value in now.items() if name != "dense_cell"}
    for settings in (now, older, {}):  # what was not known then is no reason
        row = {**place, "settings": settings}
        assert joined([], [row], [case]) == ([row], 1)
    filled = {**now, "side": {**now["side"], "holes": True}}
    assert joined([], [{**place, "settings": filled}], [case]) == ([], 0)
    assert joined([{**place, "settings": now}], [{**place, "settings": filled}], [case])[1] == 0


def test_settings_differ_in_what_both_know():
    assert not contradicts({"a": 1, "b": {"c": 2}}, {"b": {"c": 2, "d": 3}, "e": 4})
    assert contradicts({"b": {"c": 2}}, {"b": {"c": 3}})
    assert contradicts({"b": {"c": 2}}, {"b": None})


def test_a_default_of_before_that_is_known_is_no_difference():
    old, new = {"a": 1, "b": {"c": 2}}, {"a": 1, "b": {"c": 3}}
    assert not contradicts(old, new, {"b.c": 2})
    assert contradicts({"b": {"c": 4}}, new, {"b.c": 2})  # neither of before nor of now
    assert contradicts({"b": {"c": 2}, "a": 2}, new, {"b.c": 2})
    assert contradicts({"c": 2}, {"c": 3}, {"b.c": 2})  # another setting of that name


def test_pictures_at_hand_take_the_places_of_those_before():
    a, b, c = (Picture(path=f"{name}.jpg", caption=name) for name in "abc")
    later = Picture(path="a.jpg", caption="later")
    assert pictures_of([c, later], [a, b], []) == [later, b, c]
    assert pictures_of([a, b], [], []) == [a, b]
    own = replace(a, row="x")
    assert pictures_of([b], [own], [{"row": "x"}]) == [own, b]
    assert pictures_of([b], [own], [{"row": "y"}]) == [b]


def row(name: str, seed: int = 0, **changed: Any) -> Measured:
    values = {"psnr": 20.0 + seed, "disk_mb": 2.0, "render_ms": 20.0, **changed.pop("values", {})}
    plain: dict[str, Any] = {"scene": "s", "row": name, "protocol": "p", "seed": seed, "steps": 100, "grown": 2,
                             "late_gain": 0.1, "machine": "cores 2", "data": "d", "values": values,
                             "images": {"v": {"psnr": values["psnr"]}}}  # fmt: skip
    return Measured(**{**plain, **changed})


def small_page(rows: list[Measured], **changed: Any) -> Page:
    claim = Claim(paper="P", text="a is better", row="a", other="b", metric="psnr", printed=3.0)
    plain: dict[str, Any] = {"suite": "street", "title": "T", "intro": "I", "findings": "",
                             "planned": {("s", "p", "a"): 3, ("s", "p", "a@half"): 1, ("s", "p", "b"): 3},
                             "rows": rows, "claims": [claim], "printed": ()}  # fmt: skip
    return Page(**{**plain, **changed})


def some_rows() -> list[Measured]:
    return [
        *(row("a", seed) for seed in range(3)),
        row("a@half", values={"psnr": 19.9}),
        *(row("b", seed, values={"psnr": 16.0 + seed}) for seed in range(3)),
    ]


def test_a_page_names_records_that_have_no_settings():
    known = [replace(one, settings={"iterations": 100}) for one in some_rows()]
    assert "before records kept their settings" not in render_page(small_page(known), [])
    text = render_page(small_page([*known[:-1], row("b", 2)]), [])
    assert "1 of 7 records are of before records kept their settings" in text
    assert "not checked against theirs: b (1)." in text


def test_a_page_names_rows_whose_frames_had_turns_with_one_another():
    rows = some_rows()
    assert "times beside other work.\n" in render_page(small_page(rows), [])
    turned = [replace(one, turns="x" if one.row == "b" else "") for one in rows]
    text = render_page(small_page(turned), [])
    told = (
        "but those of a frame of `b` (s, p), which had turns with one another (`bench frames`).\n"
    )
    assert f"times beside other work, {told}" in text
    both = [replace(one, turns="y" if one.row == "a" else one.turns) for one in turned]
    assert "of a frame of `a` (s, p); `b` (s, p), which" in render_page(small_page(both), [])


def test_a_page_shows_verdicts_tables_and_lengths():
    text = render_page(small_page(some_rows()), [Picture(path="x.jpg", caption="See")])
    assert "All 3 rows of the suite are here." in text
    assert "1 claims: 1 *holds*." in text
    assert "| **holds** | P: a is better | `a` − `b`, psnr | +3 | +4 [" in text
    assert "| a | 3 | 21.00 ± 2.48 | 2.00 ± 0.00 |" in text  # t(2) = 4.303 times 1 / sqrt(3)
    quality, lengths = text.split("What a run took")
    assert "| a@half |" not in quality  # a control, no row to be compared
    assert "| a@half | 100 | 2 | 0.10 |" in lengths
    assert "![See](x.jpg)" in text
    assert "Failed" not in text


@pytest.mark.parametrize("side", ["row", "other"])
def test_a_row_of_another_length_that_a_claim_compares_is_in_the_tables(side):
    planned = {("s", p, name): 3 for p in "pq" for name in ("a", "a@half", "a@c-double")}
    double = [row("a@c-double", seed, values={"psnr": 23.0 + seed}) for seed in range(3)]
    rows = [replace(one, protocol=p) for p in "pq" for one in (*some_rows(), *double)]
    double_side: dict[str, Any] = {side: "a@c-double"}
    claims = [replace(claim, **double_side) for claim in small_page([]).claims]
    text = render_page(small_page(rows, planned=planned, claims=claims), [])
    beside, *places = text.split("\n## ")[2:]
    assert "| a@c-double | 24.00 ± 2.48 | 24.00 ± 2.48 |" in beside
    for place in places:
        quality, lengths = place.split("What a run took")
        assert "| a@c-double | 3 | 24.00 ± 2.48 |" in quality
        assert "| a@c-double | 100 |" in lengths
        assert "| a@half |" not in quality
        assert "| a@half |" in lengths


def test_anchors_are_not_taken_for_gaussians():
    counted = [replace(one, values={**one.values, "primitives": 1234.0}) for one in some_rows()]
    planned = {("s", "p", "a"): 3, ("s", "p", "hdgs@n2"): 3}
    rows = [replace(one, row=one.row.replace("b", "hdgs@n2")) for one in counted]
    text = render_page(small_page(rows, planned=planned), [])
    assert "stored primitives |" in text
    assert "| Gaussians |" not in text
    assert "| 1,234 ± 0 |\n" in text
    assert "| 1,234 ± 0 † |\n" in text
    assert "†: anchors" in text
    assert "†" not in render_page(small_page(counted), [])


def test_methods_of_anchors_are_known():
    fields = {
        name: {field.name for field in fields_of(method.settings)}
        for name, method in methods().items()
    }
    assert {name for name, own in fields.items() if own & {"k", "children"}} == set(ANCHORED)


def test_a_claim_over_several_scenes_names_them():
    claims = [replace(claim, scenes=("s", "t")) for claim in small_page([]).claims]
    rows = [replace(one, scene=scene) for scene in "st" for one in some_rows()]
    text = render_page(replace(small_page(rows), claims=claims), [])
    assert "`a` − `b`, psnr, mean of s, t |" in text


def test_protocols_of_a_scene_stand_side_by_side():
    planned = {("s", "p", "a"): 3, ("s", "q", "a"): 1, ("s", "q", "a@half"): 1}
    rows = [*some_rows(), row("a", protocol="q"), row("a@half", protocol="q")]
    text = render_page(small_page(rows, planned=planned), [])
    assert "| row | p | q |\n|---|---:|---:|\n| a | 21.00 ± 2.48 | 20.00 |\n\n" in text
    assert "by protocol" not in render_page(small_page(rows), [])


def test_an_incomplete_suite_says_what_is_missing_and_why():
    rows = [row("a"), row("b", error="it broke")]
    text = render_page(small_page(rows), [])
    assert "lack seeds: a (1 of 1), a@half (1 of 1), b (1 of 1)." in text
    assert "**Incomplete**: 3 of 3 rows (a scene and protocol each)" in text
    assert "- b seed 0: it broke" in text
    assert "**not testable here**" in text
    assert "b failed: it broke" in text
    assert "## Pictures" not in text
    empty = render_page(small_page([]), [])
    assert "a has not been run" in empty
    assert "Measured on nothing yet" in empty


def test_ratios_are_shown_in_per_cent():
    claim = Claim(paper="P", text="smaller", row="a", other="b", metric="disk_mb", better="lower",
                  printed=-0.69, relative=True)  # fmt: skip
    rows = [
        replace(one, values={**one.values, "disk_mb": 1.0 if one.row == "a" else 4.0})
        for one in some_rows()
    ]
    text = render_page(small_page(rows, claims=[claim]), [])
    assert "| -69 % | -75 % [-75 %, -75 %] | 3 |" in text


def test_printed_rows_beside_ours():
    lines = (Line(method="PVG", variant="box=none; 1280x1920*", row="a"),
             Line(method="HDGS", variant="box=none; 1280x1920*", row="b"))  # fmt: skip
    table = Printed(paper="HDGS", table="3", title="x", dataset="Waymo (SA)", lines=lines,
                    metrics=("psnr", "fps"), without="image reconstruction")  # fmt: skip
    assert printed_value(table, lines[0], "psnr") == 28.11
    assert printed_value(table, lines[1], "fps") == 49
    assert ours(table, lines[0], "psnr", some_rows()) == 21
    assert ours(table, lines[0], "fps", some_rows()) == 50
    text = printed_tables([table], some_rows())[-1]
    # printed: HDGS is above PVG; here b is below a, and as fast
    assert "psnr 0 of 1; fps 0 of 1." in text
    assert "Here: mean over s." in text
    busy = [
        replace(one, values={**one.values, "train_seconds": 9.0, "cpu_seconds": 3.0})
        for one in some_rows()
    ]
    assert (
        "psnr 0 of 1; fps not testable here (a, b: timed while the machine had other work)."
        in (printed_tables([table], busy)[-1])
    )
    together = [replace(one, turns="x") for one in busy]
    assert "psnr 0 of 1; fps 0 of 1." in printed_tables([table], together)[-1]
    turned = [replace(one, row="b" if one.row == "a" else "a") for one in some_rows()]
    assert "psnr 1 of 1" in printed_tables([table], turned)[-1]
    assert "psnr 0 of 0" in printed_tables([table], [])[-1]
    assert math.isnan(ours(replace(table, protocol="q"), lines[0], "psnr", some_rows()))
    assert printed_tables([], some_rows()) == []
    # a mean over scenes that the other row lacks would not compare
    more = [*some_rows(), row("b", scene="t", values={"psnr": 40.0})]
    assert printed_tables([table], more)[-1] == text


def views(moving: dict[int, tuple[int, int]]):
    """Eight views, of which some have a moving square of 4 x 4 with its corner at (row, column)."""
    scene = tiny_scene(points=4)
    made = []
    for index in range(8):
        mask = torch.zeros(scene.views[0].size, dtype=torch.bool)
        if index in moving:
            top, left = moving[index]
            mask[top : top + 4 + index, left : left + 4] = True
        load = lambda mask=mask: {"vehicles": mask, "people": torch.zeros_like(mask)}
        made.append(replace(scene.views[0], name=f"v{index}.png", load_moving=load))
    return made


def test_strips_show_the_views_with_most_that_moves_around_it():
    height, width = views({})[0].size
    chosen = crops(views({i: (0, 0) for i in range(1, 8)}))
    assert [crop.view for crop in chosen] == [f"v{i}.png" for i in range(3, 8)]
    assert (chosen[0].top, chosen[0].left) == (0, 0)
    assert (chosen[0].height, chosen[0].width) == (round(SHARE * height), round(SHARE * width))
    (corner,) = crops(views({2: (height - 4, width - 4)}))
    assert (corner.top + corner.height, corner.left + corner.width) == (height, width)
    (middle,) = crops(views({2: (height // 2 - 3, width // 2 - 2)}))
    assert abs(middle.top + middle.height / 2 - height / 2) <= 1


def test_where_nothing_moves_whole_views_are_spread():
    chosen = crops(views({}))
    assert [crop.view for crop in chosen] == [f"v{i}.png" for i in (0, 2, 4, 5, 7)]
    assert len(chosen) == VIEWS
    assert chosen[0].part == tuple(slice(0, side) for side in views({})[0].size)
    assert len(crops(views({})[:1])) == 1


def test_a_strip_holds_photo_render_and_error(tmp_path):
    chosen = crops(views({2: (0, 0), 3: (0, 0)}))
    height, width = views({})[0].size
    for kind, value in (("truth", 50), ("renders", 100), ("errors", 200)):
        (tmp_path / kind).mkdir()
        for crop in chosen:
            cv2.imwrite(
                str(tmp_path / kind / crop.view), np.full((height, width, 3), value, np.uint8)
            )
    found = strip(tmp_path, chosen, "a row")
    tile = round(WIDTH * chosen[0].height / chosen[0].width)
    assert found.shape[1] == 2 * WIDTH + 4
    values = [int(found[-1 - (2 - i) * tile - tile // 2, WIDTH // 2, 0]) for i in range(3)]
    assert values == [50, 100, 200]
    (tmp_path / "errors" / chosen[0].view).unlink()
    with pytest.raises(FileNotFoundError, match="no such picture; run the case again"):
        strip(tmp_path, chosen, "a row")
