"""The page of suite auto: made of the committed rows, its regret by hand."""

import math
from pathlib import Path

import pytest
from make_auto_page import Row, page, regret, regrets, table

DOCS = Path(__file__).parents[2] / "docs"


def row(name: str, seed: int, psnr: float, *, seconds: float = 60.0, primitives: int = 1000) -> Row:
    return Row(
        scene="yard", protocol="p", row=name, seed=seed, psnr=psnr, primitives=primitives,
        seconds=seconds, machine="m", plan={"steps": "5 (because)"} if name == "auto" else {},
    )  # fmt: skip


AUTO = [row("auto", seed, 25.0 + seed) for seed in range(3)]
WORSE = [row("auto@a", seed, 24.0 + seed) for seed in range(3)]
BETTER = [row("auto@b", seed, 25.1 + seed + 0.01 * seed, seconds=50.0) for seed in range(3)]


def test_the_committed_page_is_what_the_generator_makes_of_the_committed_rows():
    assert (DOCS / "auto.md").read_text(encoding="utf-8") == page(DOCS)


def test_regret_is_to_the_best_fixed_choice_in_pairs_of_a_seed():
    found = regret([*AUTO, *WORSE, *BETTER])
    assert found is not None
    assert (found.best, found.seeds, found.seconds, found.gaussians) == ("auto@b", 3, 10.0, 1.0)
    assert found.psnr == pytest.approx(0.11)
    assert found.verdict == "near"
    assert regret(AUTO) is None
    assert regret(WORSE) is None


@pytest.mark.parametrize(
    ("gains", "gaussians", "verdict"),
    [
        ((1.0, 1.1, 1.2), 1000, "behind"),
        ((-1.0, 0.3, 1.2), 1000, "undecided"),
        ((0.1,), 1000, "near, too few seeds"),
        ((0.5,), 1000, "behind, too few seeds"),
        ((-1.0, -1.0, -1.0), 800, "too many Gaussians"),
    ],
)
def test_what_is_said_of_it(gains, gaussians, verdict):
    other = [
        row("auto@b", seed, 25 + seed + gain, primitives=gaussians)
        for seed, gain in enumerate(gains)
    ]
    found = regret([*AUTO, *other])
    assert found is not None
    assert found.verdict == verdict
    assert math.isnan(found.low) == (len(gains) < 2)


def test_a_line_a_scene_and_a_line_a_row():
    lines = regrets({("yard", "p"): [*AUTO, *WORSE, *BETTER]}).splitlines()
    assert lines[2].startswith("| yard | p | 3 | auto@b | +0.11 dB [")
    assert lines[2].endswith("| +10 | 1.00 | near |")
    rows = table([*AUTO, *WORSE, *BETTER]).splitlines()
    assert [line.split(" | ")[0] for line in rows[2:]] == ["| auto@b", "| auto", "| auto@a"]
    assert "| -1.00 |" in rows[4]
