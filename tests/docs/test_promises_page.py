"""docs/promises.md is what the tests assert."""

import re
from pathlib import Path

from make_promises_page import PAGE, page

ROOT = Path(__file__).parents[2]


def test_the_page_is_made_from_the_tests():
    assert PAGE.read_text(encoding="utf-8") == page()


def test_every_file_and_command_that_it_names_is_there():
    for name in re.findall(r"`((?:tests|docs)/[\w/.]+)`", page()):
        assert (ROOT / name).exists(), name
    targets = (ROOT / "Makefile").read_text()
    for target in re.findall(r"`make ([\w-]+)`", page()):
        assert f"\n{target}:" in targets
