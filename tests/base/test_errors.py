"""An error is one line of bounded length, whatever a file's values are."""

import pytest

from splatproof.base.errors import END, LONGEST, DataError


@pytest.mark.parametrize("value", ["a\nb", "a\r\nb", "\x1b[2J", "\x85", "\u2028", "\x00"])
def test_what_ends_a_line_is_escaped(value):
    said = str(DataError(f"a.json: found {value}, expected b"))
    assert len(said.splitlines()) == 1
    assert said.isprintable()
    assert said.startswith("a.json: found ")
    assert said.endswith(", expected b")


def test_a_long_value_loses_its_middle():
    said = str(DataError("a.json: found " + "x" * 10**6 + ", expected b"))
    assert said.startswith("a.json: found xxx")
    assert "characters left out" in said
    assert said.endswith("xxx, expected b")
    assert len(said) < LONGEST + END


def test_other_words_stay_as_they_are():
    text = "naïve/ñ.png: 3 × 4 – found 'ü', expected “ö”"
    assert str(DataError(text)) == text
