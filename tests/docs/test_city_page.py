"""The city page: verdicts, tables, and that the committed page is made of the committed rows."""

import importlib.util
import json
from pathlib import Path

from city_page import PLY_NUMBERS, Picture, render_city, row_of

from splatproof.reference.types.result import Result

DOCS = Path(__file__).parents[2] / "docs"


def row(name: str, seed: int = 0, blocks: int = 4, error: str = "", **values: float) -> dict:
    return {
        "scene": "town", "row": name, "protocol": "p", "seed": seed, "blocks": blocks,
        "steps": 10, "error": error, "machine": "cores 2", "grown": 0, "values": values,
    }  # fmt: skip


def test_seeds_become_means_with_intervals_and_gaps_become_dashes():
    rows = [row("a", seed=s, psnr=v, flip=0.5) for s, v in ((0, 20.0), (1, 22.0))]
    text = render_city([*rows, row("b", psnr=1.0)], [Picture(path="x.jpg", caption="See")])
    half = 12.706 * 2**0.5 / 2**0.5  # Student's t of one degree of freedom, s / sqrt(n) = 1
    assert f"| a | 4 | 21.00 ± {half:.2f} | 0.5000 ± 0.0000 |" in text
    assert "| b | 4 | 1.00 | – |" in text
    assert "![See](x.jpg)" in text
    assert "SSIM" not in text.split("## town")[1]  # no row has it
    assert "- c: it broke" not in text
    assert "- c seed 0: it broke" in render_city([*rows, row("c", error="it broke")], [])


def test_what_older_rows_do_not_say_is_a_dash_and_what_no_row_of_a_scene_says_no_column():
    rows = [
        row("old", retention=0.5),
        row("new", retention=0.5, least_visits=41.0, stitch_peak_mb=512.4),
    ]
    text = render_city(rows, []).split("## town")[1]
    assert "| row | K | visits ≥ | kept % |" in text
    assert "| old | 4 | – | 50.0 |" in text
    assert "| new | 4 | 41 | 50.0 |" in text
    assert "| row | K | stitch |\n|---|---|---:|\n| new | 4 | 512 |" in text
    assert "visits" not in render_city(rows[:1], []).split("## town")[1]


def test_what_nobody_ran_is_named_and_one_model_grew_as_often_as_its_trainer_says():
    one = row("3dgs", psnr=1.0) | {"blocks": 1, "grown": 7}
    rows = [one, row("b", block_densifications=3.0)]
    text = render_city(
        rows, [], planned=[("town", "b"), ("town", "c"), ("farm", "c"), ("town", "c")]
    )
    assert "### Not run at this length\n\n- town: `c`.\n- farm: `c`.\n" in text
    assert "| 3dgs | 1 | 7 |" in text
    assert "| b | 4 | 3 |" in text
    assert "Not run" not in render_city(rows, [], planned=[("town", "b")])


def test_a_row_of_a_result():
    result = Result(
        suite="city", scene="town", method="stitchgs", variant="hard", seed=2, protocol="p",
        protocol_rules={}, settings={"blocks": 4, "iterations": 7}, images=(),
        metrics={"psnr": 20.123456789, "seam_psnr_partition": float("nan")}, stages={"blocks": 3.0, "load": 9.0},
        cpu_seconds=1.0, peak_memory_mb=1.0, primitives=10, bytes_on_disk=2**20, render_ms=20.0,
        split_sha256="", model_sha256="", counters={"least_visits": 12, "render_pairs": 5},
    )  # fmt: skip
    found = row_of(result)
    assert found["values"]["least_visits"] == 12
    assert "render_pairs" not in found["values"]
    assert (found["row"], found["blocks"], found["steps"]) == ("stitchgs@hard", 4, 7)
    values = found["values"]
    assert (values["fps"], values["disk_mb"], values["training_seconds"]) == (50.0, 1.0, 3.0)
    assert values["ply_bytes"] == 40 * PLY_NUMBERS
    assert values["psnr"] == 20.1235
    assert "seam_psnr_partition" not in values
    assert json.loads(json.dumps(found)) == found


def generator():
    spec = importlib.util.spec_from_file_location(
        "make_city_page", DOCS / "tools" / "make_city_page.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_committed_page_is_what_the_generator_makes_of_the_committed_rows():
    assert (DOCS / "city.md").read_text(encoding="utf-8") == generator().page()


def test_the_page_judges_as_the_claims_page_does():
    """In its words, and without a rule of its own."""
    claims = (DOCS / "claims.md").read_text(encoding="utf-8")
    found = generator().expected()
    assert len(found) > 30
    assert {one.verdict for one in found} >= {"holds", "too short to judge"}
    page = generator().page()
    for one in found:
        line = next(text for text in page.splitlines() if one.text in text)
        assert line.startswith(f"| {one.verdict} | {one.text} |"), line
        assert line.endswith(f"| {one.reason} |"), line
        own = next(text for text in claims.splitlines() if one.text in text)
        assert one.here in own, own
        assert one.verdict in own or one.verdict == "not testable here", own
    assert "refuted" not in page


def test_every_picture_of_the_page_is_there():
    shown = json.loads((DOCS / "city_pictures.json").read_text(encoding="utf-8"))
    assert shown
    for entry in shown:
        assert (DOCS / entry["path"]).is_file()
