"""docs/performance.md is what the generator makes of docs/performance.json."""

import csv
import json
import math
import re
from pathlib import Path

import pytest

from splatproof.base.errors import DataError, MissingError
from splatproof.cli import main
from splatproof.cli.study import read_rows
from splatproof.suites.studies.speed import page as speed_page

DOCS = Path(__file__).parents[4] / "docs"
MACHINE = {"cpu": "Some CPU", "cores": "2", "simd": "avx512", "gpu": ""}
PEERS_MACHINE = {"cpu": "Intel Xeon Processor", "cores": "2", "simd": "avx512", "gpu": ""}


def row(component: str, twin: str, case: str, **values: object) -> dict:
    return {
        "component": component, "twin": twin, "case": case, "size": [20_000, 320, 240],
        "forward_ms": 4.0, "backward_ms": 6.0, "max_abs_error": 1e-7, "rms_error": 1e-8,
        "grad_rel_l2": 2e-7, "grad_cosine": 1.0, "discontinuity_pixels": 3, "peak_mb": 200.0,
        "added_mb": 50.0, "contributing_pairs": 2_000_000, "usual": True, "growth": False,
        "approximates": "", "error_case": "small", "ok": True, "note": "", **values,
    }  # fmt: skip


ROWS = [
    row("pipeline", "cpu", "20000 320x240"),
    row("rasterizer", "cpu avx512", "20000 320x240"),
    row("rasterizer", "rough", "20000 320x240", usual=False, approximates="much", grad_rel_l2=None),
    row("roofline", "multiply-adds", "avx512", level="avx512", value=400.0, unit="GFLOP/s"),
    row(
        "roofline",
        "blend",
        "x",
        level="avx512",
        floor_ms=2.0,
        share=0.5,
        bound="loop",
        backward_ms=None,
    ),
]


def test_the_committed_page_is_what_the_generator_makes_of_the_committed_rows(tmp_path):
    page = tmp_path / "performance.md"
    recorded = DOCS / "performance.json"
    assert main(["study", "speed", "--rows", str(recorded), "--page", str(page)]) == 0
    assert page.read_text() == (DOCS / "performance.md").read_text()
    assert page.with_suffix(".json").read_text() == recorded.read_text()
    for name in ("pareto", "growth"):
        assert (DOCS / "images" / "performance" / f"{name}.png").exists()


def test_the_committed_rows_are_undisturbed_or_refused():
    _, rows = read_rows(DOCS / "performance.json")
    for found in rows:
        share = found["disturbed_percent"]
        assert found["ok"] or "refused" in found["note"], found
        assert not found["ok"] or share is None or share <= 5, found
    timed = {row["case"] for row in rows if row["ok"]}
    with speed_page.PEERS.open(newline="") as file:
        assert {peer["case"] for peer in csv.DictReader(file)} <= timed


def section(page: str) -> str:
    """What stands beside the peers."""
    return page.split("## Beside the public CPU peers")[1].split("\n## ")[0]


def test_shares_are_computed():
    page = speed_page.page(MACHINE, ROWS, ["images/a.png"])
    assert "| blend | avx512 | 4.00 | 2.00 | 50 % | loop |" in page
    assert "| 20000 320x240 | 4.00 | 6.00 | 2.00 | 5.00 | 500 | 200 | 50.0 |" in page
    assert "| rough * |" in page
    assert "rough: much" in page
    assert "GPU" not in page
    assert "![a](images/a.png)" in page


def test_every_time_beside_peers_names_its_machine():
    page = section(speed_page.page(MACHINE, ROWS, []))
    lines = [line.split(" | ") for line in page.splitlines() if line.startswith("| 20000 320x240")]
    assert ["| 20000 320x240", "splatproof", "Some CPU, 2 cores, avx512", "10.0", "200 |"] in lines
    assert [
        "| 20000 320x240", "OpenSplat 1.2.0", "Intel Xeon Processor, 2 cores, avx512", "125", "182 |"
    ] in lines  # fmt: skip


def test_no_ratio_stands_across_machines():
    page = section(speed_page.page(MACHINE, ROWS, []))
    assert not re.search(r"\d+x \|", page)
    assert "| case | rasterizer | machine | ms | peak MB |" in page
    assert "do not compare" in page


def test_ratios_on_one_machine_are_computed():
    page = section(speed_page.page(PEERS_MACHINE, ROWS, []))
    name = "Intel Xeon Processor, 2 cores, avx512"
    assert f"| 20000 320x240 | OpenSplat 1.2.0 | {name} | 125 | 182 | 12.5x | 10.0 / 18.0 |" in page
    assert f"| 100000 320x240 | OpenSplat 1.2.0 | {name} | 312 | 347 | - | 10.0 / 16.0 |" in page
    assert "do not compare" not in page


def test_the_committed_page_has_no_ratio_across_machines():
    """Peers and rows were measured on processors of two makers."""
    machine, _ = read_rows(DOCS / "performance.json")
    with speed_page.PEERS.open(newline="") as file:
        theirs = {peer["machine"] for peer in csv.DictReader(file)}
    assert speed_page.machine_name(machine) not in theirs
    assert not re.search(r"\d+x \|", section((DOCS / "performance.md").read_text()))


def test_every_peer_is_measured_and_says_where():
    with speed_page.PEERS.open(newline="") as file:
        peers = list(csv.DictReader(file))
    assert len(peers) > 10
    for peer in peers:
        assert float(peer["forward_ms"]) > 0
        assert peer["source"]
        assert re.fullmatch(r".+, \d+ cores, \w+", peer["machine"])
        assert bool(peer["must"]) == bool(peer["aim"])


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (None, "-"), (math.inf, "-"), (1234.5, "1,234"), (12.345, "12.3"),
     (0.0123456, "0.0123"), (1.5e-7, "1.50e-07"), (2e7, "2.00e+07")],
)  # fmt: skip
def test_numbers_have_three_digits(value, text):
    assert speed_page.number(value) == text


def test_a_file_without_rows_is_refused(tmp_path):
    with pytest.raises(MissingError, match="no such file"):
        read_rows(tmp_path / "none.json")
    rows = "expected machine and rows"
    for text, said in (("{", "not JSON"), ("[]", rows), (json.dumps({"rows": []}), rows)):
        (tmp_path / "a.json").write_text(text)
        with pytest.raises(DataError, match=rf"a\.json: .*{said}"):
            read_rows(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["study", "partition", "--page", "x.md"], "--page"),
        (["study", "speed", "--rows", "x.json"], "give --page"),
        (["study", "speed", "--wait", "-1"], "expected seconds"),
    ],
)
def test_options_that_do_not_fit_are_refused(arguments, said, capsys, tmp_path):
    assert main([*arguments, "--out", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err
