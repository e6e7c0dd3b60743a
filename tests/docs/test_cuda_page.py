"""docs/cuda.md is what the committed rows give."""

import json

from make_cuda_page import GPU, PAGE, ROWS, page


def test_the_page_is_made_from_the_committed_rows():
    assert PAGE.read_text(encoding="utf-8") == page()


def test_every_gpu_row_was_within_its_budget():
    rows = json.loads(ROWS.read_text(encoding="utf-8"))["rows"]
    assert {row["twin"] for row in rows} >= set(GPU)
    assert all(row["ok"] for row in rows)
