"""The city page: verdicts by hand, tables, and that the committed page is made of the committed rows."""

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest
from city_expectations import expectations, named, suffix
from city_page import PLY_NUMBERS, Picture, render_city, row_of

from splatproof.reference.types.result import Result

DOCS = Path(__file__).parents[2] / "docs"


def row(name: str, seed: int = 0, blocks: int = 4, error: str = "", **values: float) -> dict:
    return {
        "scene": "town", "row": name, "protocol": "p", "seed": seed, "blocks": blocks,
        "steps": 10, "error": error, "machine": "cores 2", "values": values,
    }  # fmt: skip


def good() -> list[dict]:
    """Rows of which every expectation holds, by a little."""
    spread: dict[str, Any] = {"seconds_max_over_mean": 1.3}
    return [
        row("3dgs", blocks=1, psnr=20.0),
        row("citygaussian", psnr=19.0, **spread),
        row("vastgaussian", psnr=19.0, **spread),
        row("blockgaussian", psnr=19.0, **spread),
        row("dpgs-partition", psnr=20.0, seconds_max_over_mean=1.29),
        row("stitchgs@hard", psnr=19.0, seam_psnr=18.0, bpd_l1=0.10),
        row("stitchgs@gcr", psnr=20.2, seam_psnr=19.0, bpd_l1=0.09),
        row(
            "stitchgs", psnr=20.0, seam_psnr=18.9, bpd_l1=0.09, ply_bytes=300.0, packed_bytes=100.0
        ),
        row("odbp+stitch", psnr=19.9),
    ]


def outcomes(rows: list[dict]) -> list[str]:
    return [found.outcome for found in expectations(rows)]


def changed(name: str, key: str, value: float) -> list[dict]:
    rows = good()
    for one in rows:
        if one["row"] == name:
            one["values"][key] = value
    return rows


def test_all_hold():
    assert outcomes(good()) == ["confirmed"] * 4
    assert "K = 4: Seam PSNR 18.00 to 19.00 dB (+1.00)" in expectations(good())[1].numbers[0]


@pytest.mark.parametrize(
    ("which", "name", "key", "value"),
    [
        (0, "dpgs-partition", "seconds_max_over_mean", 1.3),
        (0, "vastgaussian", "seconds_max_over_mean", 1.2),
        (1, "stitchgs@gcr", "seam_psnr", 18.99),
        (1, "stitchgs@gcr", "bpd_l1", 0.1),
        (2, "stitchgs", "packed_bytes", 101.0),
        (2, "stitchgs", "psnr", 19.99),
        (3, "odbp+stitch", "psnr", 19.85),
        (3, "stitchgs", "psnr", 20.01),
    ],
)
def test_each_part_of_an_expectation_can_refute_it(which, name, key, value):
    found = outcomes(changed(name, key, value))
    assert found[which] == "refuted"


def test_one_scene_that_fails_refutes_and_missing_rows_are_not_measured():
    other = [one | {"scene": "village"} for one in changed("odbp+stitch", "psnr", 1.0)]
    assert outcomes(good() + other)[3] == "refuted"
    assert len(expectations(good() + other)[3].numbers) == 2
    assert outcomes([one for one in good() if one["row"] != "vastgaussian"])[0] == "not measured"
    assert outcomes([]) == ["not measured"] * 4


def test_rows_of_other_k_are_compared_among_themselves():
    assert (suffix("stitchgs@k8-hard"), suffix("stitchgs@hard"), suffix("3dgs")) == ("k8", "", "")
    assert suffix("stitchgs@keep") == ""
    assert (named("stitchgs@hard", "k8"), named("a", "k8"), named("a@b", "")) == (
        "stitchgs@k8-hard", "a@k8", "a@b",
    )  # fmt: skip
    eight = [one | {"row": named(one["row"], "k8"), "blocks": 8} for one in good()[1:]]
    found = expectations(good() + eight)[0]
    assert [line.split(":")[0] for line in found.numbers] == ["town, K = 4", "town, K = 8"]


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


def test_a_row_of_a_result():
    result = Result(
        suite="city", scene="town", method="stitchgs", variant="hard", seed=2, protocol="p",
        protocol_rules={}, settings={"blocks": 4, "iterations": 7}, images=(),
        metrics={"psnr": 20.123456789, "seam_psnr": float("nan")}, stages={"blocks": 3.0, "load": 9.0},
        cpu_seconds=1.0, peak_memory_mb=1.0, primitives=10, bytes_on_disk=2**20, render_ms=20.0,
        split_sha256="", model_sha256="",
    )  # fmt: skip
    found = row_of(result)
    assert (found["row"], found["blocks"], found["steps"]) == ("stitchgs@hard", 4, 7)
    values = found["values"]
    assert (values["fps"], values["disk_mb"], values["training_seconds"]) == (50.0, 1.0, 3.0)
    assert values["ply_bytes"] == 40 * PLY_NUMBERS
    assert values["psnr"] == 20.1235
    assert "seam_psnr" not in values
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


def test_every_picture_of_the_page_is_there():
    shown = json.loads((DOCS / "city_pictures.json").read_text(encoding="utf-8"))
    assert shown
    for entry in shown:
        assert (DOCS / entry["path"]).is_file()
