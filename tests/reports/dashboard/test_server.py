"""The server answers this machine's own pages and nobody else."""

import shutil
from pathlib import Path

import pytest

from helpers.dashboard_server import serving
from helpers.local_requests import ask
from splatproof.base.errors import UsageError
from splatproof.base.local_server import listening
from splatproof.reports.dashboard.cache import Cache
from splatproof.reports.dashboard.site import Site


def test_the_page_comes_with_its_policy(port: int):
    answer = ask(port, "/")
    assert answer.status == 200
    assert answer.text.startswith("<!doctype html>")
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert answer.headers["cross-origin-resource-policy"] == "same-origin"
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "name", ["evil.example", "evil.example:PORT", "127.0.0.1:1", "", "127.0.0.1.evil.example:PORT"]
)
def test_another_name_is_refused(port: int, name: str):
    answer = ask(port, "/data/index.js", host=name.replace("PORT", str(port)))
    assert answer.status == 421
    assert "take(" not in answer.text


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "[::1]"])
def test_this_machines_names_are_answered(port: int, name: str):
    assert ask(port, "/app/core.js", host=f"{name}:{port}").status == 200


@pytest.mark.parametrize("place", ["cross-site", "same-site"])
def test_data_is_refused_to_pages_from_elsewhere(port: int, place: str):
    assert ask(port, "/data/index.js", sec_fetch_site=place).status == 403
    assert ask(port, "/", sec_fetch_site=place).status == 200  # a link to the page may be followed
    assert ask(port, "/data/index.js", sec_fetch_site="same-origin").status == 200


def test_only_reading_is_answered(port: int):
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert ask(port, "/data/index.js", method).status == 405
    for path in ("/nothing", "/app/%2e%2e/site.py", "/app/../site.py", "//etc/passwd"):
        assert ask(port, path).status == 404


def test_a_store_that_is_gone_is_told(store_uri: str, tmp_path: Path):
    shutil.copy(store_uri.removeprefix("sqlite:///"), tmp_path / "mlflow.db")
    site = Site(f"sqlite:///{tmp_path}/mlflow.db", Cache(None), ())
    (tmp_path / "mlflow.db").write_bytes(b"x" * 5000)
    with serving(site) as port:
        answer = ask(port, "/data/index.js")
    assert answer.status == 500
    assert "cannot be read" in answer.text


def test_the_socket_is_of_this_machine_alone_and_a_taken_port_is_told():
    with listening(0) as one:
        assert one.getsockname()[0] == "127.0.0.1"
        with pytest.raises(UsageError, match="choose another"):
            listening(one.getsockname()[1])
