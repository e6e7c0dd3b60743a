"""Files that are there whole or not at all, and JSON with one-line errors."""

import hashlib
from pathlib import Path

import pytest

from splatproof.base import files
from splatproof.base.errors import DataError


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "deep" / "a.bin"
    with files.whole_file(path) as partial:
        partial.write_bytes(b"old")
        assert not path.exists()
    with pytest.raises(KeyboardInterrupt), files.whole_file(path) as partial:  # noqa: PT012
        partial.write_bytes(b"ha")
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    files.write_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert [entry.name for entry in path.parent.iterdir()] == ["a.bin"]
    assert files.sha256(path) == hashlib.sha256(b"new").hexdigest()


def test_text_is_utf_8_and_keeps_its_line_ends(tmp_path):
    files.write_text(tmp_path / "a.txt", "é\r\n")
    assert (tmp_path / "a.txt").read_bytes() == b"\xc3\xa9\r\n"


def test_json_comes_back(tmp_path):
    (tmp_path / "a.json").write_text('{"é": [1, null]}', encoding="utf-8")
    assert files.read_json(tmp_path / "a.json") == {"é": [1, None]}


def missing(path: Path) -> None:
    pass


def folder(path: Path) -> None:
    path.mkdir()


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (missing, "no such file"),
        (folder, "cannot be read: Is a directory"),
        (lambda path: path.write_text("{"), "not JSON"),
        (lambda path: path.write_bytes(b"\xff\xfe\xff"), "not JSON"),
        (lambda path: path.write_text("[" * 100_000), "not JSON"),
    ],
)
def test_json_that_cannot_be_read_is_named(tmp_path, make, match):
    make(tmp_path / "a.json")
    with pytest.raises(DataError, match=rf"a\.json: {match}") as caught:
        files.read_json(tmp_path / "a.json")
    assert "\n" not in str(caught.value)


def test_what_killed_writers_left_is_removed_and_nothing_else(tmp_path):
    (tmp_path / "inner").mkdir()
    left = tmp_path / "inner" / "a.png.17.partial"
    for path in (left, tmp_path / "a.png"):
        path.write_text("x")
    files.remove_partial_files(tmp_path)
    assert not left.exists()
    assert (tmp_path / "a.png").exists()
