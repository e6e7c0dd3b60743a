"""Downloads against a server of our own that misbehaves on request."""

import hashlib

import pytest

from helpers.file_server import served
from splatproof.base import folders
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.datasets import download as module
from splatproof.datasets.download import download

BODY = bytes(range(256)) * 4096  # 1 MiB
DIGEST = hashlib.sha256(BODY).hexdigest()


@pytest.fixture
def server():
    with served(BODY) as made:
        yield made


def fetch(server, target, sha256=DIGEST, **options):
    return download(server.url, target, sha256=sha256, wait=0.001, timeout=5.0, **options)


def test_a_plain_download(server, tmp_path):
    told = []
    path = fetch(server, tmp_path / "new" / "a.zip", report=lambda *x: told.append(x))
    assert path.read_bytes() == BODY
    assert told[-1] == (len(BODY), len(BODY))
    assert [p.name for p in path.parent.iterdir()] == ["a.zip"]


def test_a_file_with_the_right_checksum_is_not_fetched_again(server, tmp_path):
    fetch(server, tmp_path / "a.zip")
    fetch(server, tmp_path / "a.zip", sha256=DIGEST.upper())
    assert server.asked == [None]


def test_a_stopped_download_goes_on_where_it_stopped(server, tmp_path):
    (tmp_path / "a.zip.part").write_bytes(BODY[:1000])
    assert fetch(server, tmp_path / "a.zip").read_bytes() == BODY
    assert server.asked == ["bytes=1000-"]


def test_a_server_without_ranges_sends_all_again(server, tmp_path):
    server.ranges = False
    (tmp_path / "a.zip.part").write_bytes(b"x" * 1000)
    assert fetch(server, tmp_path / "a.zip").read_bytes() == BODY


def test_another_range_than_asked_for_is_not_appended(server, tmp_path):
    server.wrong_range = True
    (tmp_path / "a.zip.part").write_bytes(BODY[:1000])
    assert fetch(server, tmp_path / "a.zip").read_bytes() == BODY
    assert server.asked == ["bytes=1000-", None]


def test_truncated_bodies_are_continued(server, tmp_path):
    server.cut = [1000, 5000, 200_000]
    assert fetch(server, tmp_path / "a.zip").read_bytes() == BODY
    assert server.asked == [None, "bytes=1000-", "bytes=6000-", "bytes=206000-"]


def test_a_server_that_sends_nothing_ends_in_an_error_and_keeps_what_came(server, tmp_path):
    server.cut = [1000] + [0] * 20
    with pytest.raises(MissingError, match="attempts.*continues"):
        fetch(server, tmp_path / "a.zip")
    assert (tmp_path / "a.zip.part").stat().st_size == 1000
    assert not (tmp_path / "a.zip").exists()
    assert len(server.asked) == 1 + module.ATTEMPTS - 1


def test_a_part_that_is_whole_already_is_checked_and_named(server, tmp_path):
    (tmp_path / "a.zip.part").write_bytes(BODY)
    assert fetch(server, tmp_path / "a.zip").read_bytes() == BODY


def test_a_part_longer_than_the_file_begins_again(server, tmp_path):
    (tmp_path / "a.zip.part").write_bytes(BODY + b"more")
    assert fetch(server, tmp_path / "a.zip").read_bytes() == BODY


def test_a_wrong_checksum_leaves_nothing(server, tmp_path):
    with pytest.raises(DataError, match=DIGEST):
        fetch(server, tmp_path / "a.zip", sha256="0" * 64)
    assert not list(tmp_path.iterdir())


def test_a_wrong_checksum_does_not_replace_what_is_there(server, tmp_path):
    (tmp_path / "a.zip").write_bytes(b"older")
    with pytest.raises(DataError):
        fetch(server, tmp_path / "a.zip", sha256="0" * 64)
    assert (tmp_path / "a.zip").read_bytes() == b"older"


@pytest.mark.parametrize(("status", "asked"), [(404, 1), (403, 1), (503, module.ATTEMPTS)])
def test_a_server_that_says_no(server, tmp_path, status, asked):
    server.status = status
    with pytest.raises(MissingError, match=str(status)):
        fetch(server, tmp_path / "a.zip")
    assert len(server.asked) == asked
    assert not list(tmp_path.iterdir())


def test_nobody_listens(tmp_path):
    with served(BODY) as made:
        pass
    with pytest.raises(MissingError, match="attempts"):
        fetch(made, tmp_path / "a.zip")


def test_a_full_disk_is_told_before_the_first_byte(server, tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "RESERVE", 2**62)
    with pytest.raises(MissingError, match="free"):
        fetch(server, tmp_path / "a.zip")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("url", ["file:///etc/passwd", "ftp://example.org/x", "scene.zip"])
def test_only_web_addresses(tmp_path, url):
    with pytest.raises(UsageError, match="http"):
        download(url, tmp_path / "x", sha256=DIGEST)


@pytest.mark.parametrize(
    "other", ["ftp://127.0.0.1:9/a.zip", "file:///etc/passwd", "data:,x", "x:y"]
)
def test_a_redirect_leads_to_the_web_alone(server, tmp_path, other):
    server.moved = other
    with pytest.raises(MissingError, match="(leads to|not allowed|302)") as caught:
        fetch(server, tmp_path / "a.zip")
    assert "\n" not in str(caught.value)
    assert len(server.asked) == 1  # and not asked again and again
    assert list(tmp_path.iterdir()) == []


def test_a_redirect_on_the_web_is_followed(server, tmp_path):
    server.moved = server.url
    assert fetch(server, tmp_path / "a.zip").read_bytes() == BODY
