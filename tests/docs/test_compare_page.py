"""The example of docs/compare.md is what the command beside it prints."""

from make_compare_page import DOCS, EXAMPLE, example


def test_the_example_is_what_the_committed_results_give():
    found = EXAMPLE.search((DOCS / "compare.md").read_text(encoding="utf-8"))
    assert found is not None
    assert found[0] == found[1] + example() + found[2]
    assert "REGRESSED" in found[0]
