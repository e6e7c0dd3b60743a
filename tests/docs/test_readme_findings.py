"""The README's table of findings and the suites' pages say what the claims page says: words, numbers, verdicts."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def rows(text: str) -> list[list[str]]:
    """Cells of every row of the Markdown tables of `text`, without asterisks."""
    lines = (
        line.strip().removeprefix("|").removesuffix("|")
        for line in text.splitlines()
        if line.startswith("| ")
    )
    return [[cell.strip().replace("**", "") for cell in line.split("|")] for line in lines]


def findings(readme: str) -> list[list[str]]:
    section = readme.split("## What runs say so far")[1].split("\n## ")[0]
    return rows(section)[1:]


def test_every_finding_of_the_readme_is_a_row_of_the_claims_page():
    claims = {
        (cells[1].split("<br>")[0], cells[2], cells[3], cells[0])
        for cells in rows((ROOT / "docs" / "claims.md").read_text(encoding="utf-8"))
        if len(cells) > 3
    }
    found = findings((ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(found) == 10
    for claim, asked, here, verdict in found:
        assert (claim, asked, here, verdict) in claims, (
            f"{claim}: renew the README's row from docs/claims.md"
        )


@pytest.mark.parametrize("suite", ["anchors", "sparse", "street", "tunnel", "unseen"])
def test_a_suites_page_prints_the_intervals_of_the_claims_page(suite):
    docs = ROOT / "docs"
    claims = {
        (cells[1].split("<br>")[0], cells[3])
        for cells in rows((docs / "claims.md").read_text(encoding="utf-8"))
        if len(cells) > 3
    }
    section = (docs / f"{suite}.md").read_text(encoding="utf-8").split("## Claims")[1]
    told = [cells for cells in rows(section.split("\n#")[0]) if len(cells) > 4 and "[" in cells[4]]
    assert told
    for _, claim, _, _, here, *_ in told:
        words = claim.split(": ", 1)[1]  # and, of a paper, where the effect is printed
        mean, _, interval = here.removesuffix("]").partition(" [")
        # the claims page leaves an interval out that is no wider than the mean is told
        kept = mean if set(interval.split(", ")) == {mean} else here
        assert any(words.startswith(text) and kept == other for text, other in claims), (
            f"{claim}: {here}"
        )


def test_the_readme_counts_the_claims_of_the_page():
    page = (ROOT / "docs" / "claims.md").read_text(encoding="utf-8")
    counted = sum(int(number) for number in re.findall(r"Of (\d+) claims of", page))
    asked = re.search(r"Ten of the (\d+) claims", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert asked is not None
    assert int(asked[1]) == counted


def test_cells_are_read_without_asterisks_and_the_head_is_no_row():
    claims = rows("| holds | **a is above b**<br>paper<br>suite | +1 | +2 [+1, +3] | 3 |")[0]
    assert claims[:4] == ["holds", "a is above b<br>paper<br>suite", "+1", "+2 [+1, +3]"]
    stale = findings(
        "## What runs say so far\n\n| claim | asked | here | verdict |\n|---|---|---|---|\n| a is above b | +1 | +9 | holds |\n\n## Read on\n"
    )
    assert stale == [["a is above b", "+1", "+9", "holds"]]
