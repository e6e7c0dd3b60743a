"""The viewer answers this machine's own page and nobody else."""

import json
import socket
from dataclasses import replace
from urllib.parse import urlencode

import pytest

from helpers.local_requests import ask
from helpers.viewer import serving
from splatproof.base.errors import UsageError
from splatproof.base.local_server import listening
from splatproof.viewing.stage import Shown, Stage

FREE = {
    "eye": "0,0,-4", "forward": "0,0,1", "up": "0,-1,0", "fov": "40", "width": "32", "height": "24",
}  # fmt: skip
HOSTILE = '"><img src=x onerror=alert(1)>\u2028é'


@pytest.fixture
def port(stage: Stage):
    with serving(stage) as number:
        yield number


def test_the_page_comes_with_its_policy(port: int):
    answer = ask(port, "/")
    assert answer.status == 200
    assert answer.text.startswith("<!doctype html>")
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
    assert "POLICY" not in answer.text
    assert answer.headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.parametrize("path", ["/state.json", "/photo/0", f"/frame?{urlencode(FREE)}"])
def test_pages_from_elsewhere_get_nothing(port: int, path: str):
    assert ask(port, path).status == 200
    assert ask(port, path, host="evil.example").status == 421
    assert ask(port, path, host=f"evil.example:{port}").status == 421
    assert ask(port, path, sec_fetch_site="cross-site").status == 403
    assert ask(port, path, sec_fetch_site="same-origin").status == 200
    assert ask(port, path, "POST").status == 405


@pytest.mark.parametrize(
    "path", ["/nothing", "/app/server.py", "/app/../server.py", "/app/%2e%2e/server.py", "/photo/x",
             "/photo/-1", "/app/plotly.min.js"]
)  # fmt: skip
def test_nothing_else_is_there(port: int, path: str):
    assert ask(port, path).status == 404


def test_a_wrong_wish_is_told(port: int):
    answer = ask(port, f"/frame?{urlencode(FREE | {'fov': '900'})}")
    assert (answer.status, answer.text) == (400, "fov is 900, expected 1 to 170\n")
    assert ask(port, "/photo/99").status == 400
    assert ask(port, "/frame?turn=x").status == 400


def test_an_old_wish_is_not_drawn(port: int):
    assert ask(port, f"/frame?{urlencode(FREE | {'page': 'a', 'turn': '5'})}").status == 200
    assert ask(port, f"/frame?{urlencode(FREE | {'page': 'a', 'turn': '4'})}").status == 204
    assert ask(port, f"/frame?{urlencode(FREE | {'page': 'b', 'turn': '4'})}").status == 200


def test_any_name_fits_into_the_answer(stage: Stage):
    scene = stage.scene
    assert scene
    views = tuple(replace(view, name=f"{HOSTILE}{view.name}") for view in scene.views)
    named = Stage((Shown(name=HOSTILE, model=stage.models[0].model),), replace(scene, views=views))
    with serving(named) as port:
        assert json.loads(ask(port, "/state.json").text)["models"][0]["name"] == HOSTILE
        answer = ask(port, f"/frame?{urlencode(FREE | {'mode': 'error'})}")
        assert json.loads(answer.headers["x-frame"])["told"]["photo"].startswith(HOSTILE)


def test_answers_do_not_wait_for_acknowledgements():
    at = listening(0)
    with at, socket.create_connection(at.getsockname()) as line:
        accepted, _ = at.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0
            assert line.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 0  # the control


@pytest.mark.parametrize("port", [70000, -1])
def test_a_port_that_is_none_is_refused(port: int):
    with pytest.raises(UsageError, match="expected 0 to 65535"):
        listening(port)
