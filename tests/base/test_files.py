"""Files that are there whole or not at all, and JSON with one-line errors."""

import hashlib
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from splatproof.base import files
from splatproof.base.errors import DataError, MissingError, UsageError


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
        (folder, "is a folder, expected a file"),
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


def pipe(path: Path) -> None:
    os.mkfifo(path)


def a_socket(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # a socket's path has no more than 108 bytes
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(path.name)
    os.chdir(here)


def link_to_null(path: Path) -> None:
    path.symlink_to(os.devnull)


NOT_FILES = [
    (folder, "a folder"),
    (pipe, "a pipe"),
    (a_socket, "a socket"),
    (link_to_null, "a dev"),
]


@pytest.mark.parametrize(("make", "kind"), NOT_FILES)
@pytest.mark.parametrize("read", [files.read_bytes, files.read_text, files.read_json, files.sha256])
def test_only_regular_files_are_read(tmp_path, read, make, kind):
    make(tmp_path / "a.json")
    with pytest.raises(DataError, match=f"a.json: is {kind}"):
        read(tmp_path / "a.json")


@pytest.mark.parametrize(("make", "kind"), NOT_FILES)
def test_nothing_but_a_regular_file_is_replaced(tmp_path, make, kind):
    make(tmp_path / "a.ply")
    before = os.lstat(tmp_path / "a.ply")
    with pytest.raises(UsageError, match=f"a.ply: is {kind}.*, expected a file to write"):
        files.write_bytes(tmp_path / "a.ply", b"new")
    after = os.lstat(tmp_path / "a.ply")
    assert (before.st_mode, before.st_ino) == (after.st_mode, after.st_ino)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_names_that_no_file_can_have(tmp_path):
    (tmp_path / "file").write_text("x")
    for name, said in [
        ("n" * 300, "name too long"),
        ("file/inner/a", "file is a file, expected a folder"),
        ("nul\0", "not a name"),
        ("\ud800", "not a name"),
    ]:
        with pytest.raises(UsageError, match=f"(?i){said}"):
            files.write_bytes(tmp_path / name, b"")
        with pytest.raises(DataError, match="no such file|cannot be read"):
            files.read_bytes(tmp_path / name)
    files.write_bytes(tmp_path / ("é" * 127), b"as long as can be")
    assert (tmp_path / ("é" * 127)).read_bytes() == b"as long as can be"


def test_a_file_larger_than_the_memory_is_not_begun(tmp_path):
    with (tmp_path / "large").open("wb") as file:
        file.truncate(2**43)  # takes no room on the disk
    with pytest.raises(
        MissingError, match=r"large: takes 8388608 MB to read, more than 90% of the memory"
    ):
        files.read_bytes(tmp_path / "large")


def test_text_that_is_not_utf_8_is_named(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"ab\xff")
    with pytest.raises(DataError, match=r"a\.txt: not UTF-8 text \(byte 2\)"):
        files.read_text(tmp_path / "a.txt")
    (tmp_path / "a.txt").write_bytes(b"a\r\nb\n")
    assert files.read_text(tmp_path / "a.txt") == "a\nb\n"


def test_what_killed_writers_left_is_removed_and_what_is_written_stays(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    target = tmp_path / "a[1].ply"
    left = tmp_path / f"{target.name}.{ended.pid}.partial"
    kept = [
        tmp_path / f"{target.name}.{os.getpid()}.partial",
        tmp_path / f"a1.ply.{ended.pid}.partial",
        tmp_path / f"{target.name}.mine.partial",
    ]
    for path in (left, *kept):
        path.touch()
    files.remove_stale(target)
    assert sorted(tmp_path.iterdir()) == sorted(kept)
