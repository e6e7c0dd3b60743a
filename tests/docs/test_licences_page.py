"""What the product needs to run is free to use, and docs/licences.md says under which licence."""

import pytest
from make_licences_page import COPYLEFT, PAGE, licence, needed, page, pinned


def test_the_page_is_made_from_the_packages():
    assert PAGE.read_text(encoding="utf-8") == page()


def test_all_that_is_needed_to_run_is_pinned():
    assert needed() - set(pinned()) == set()


@pytest.mark.parametrize("name", sorted(needed()))
def test_what_is_needed_to_run_asks_for_nothing_but_names(name):
    told = licence(name)
    assert told is not None
    assert not COPYLEFT.search(told), told


def test_the_one_that_tests_use_is_seen():
    """The control."""
    told = licence("plyfile")
    assert told is not None
    assert COPYLEFT.search(told)
    assert "plyfile" not in needed()
