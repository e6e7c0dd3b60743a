"""Scene adapters of installed packages: found through entry points, after ours, named in errors."""

import dataclasses
import json
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from helpers.colmap_scenes import Flight, write_scene
from helpers.tiny_scene import tiny_scene
from splatproof.base import plugins
from splatproof.base.errors import DataError, UsageError
from splatproof.cli import main
from splatproof.datasets.catalogue.opening import (
    ADAPTERS,
    GROUP,
    Adapter,
    _all_adapters,
    open_scene,
)
from splatproof.reference.types.protocol import Protocol

PROTOCOL = Protocol(name="test", source="test")
FILM = Adapter(
    name="film",
    looks_for="film.txt",
    recognises=lambda folder: (folder / "film.txt").is_file(),
    open=lambda folder, protocol: tiny_scene(),
)
GREEDY = Adapter(
    name="greedy", looks_for="anything", recognises=lambda _: True, open=FILM.open
)  # fmt: skip


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Pretends that a package offers entry points: name of the point, attribute of this module."""

    def offer(**values: str) -> None:
        points = [
            EntryPoint(name=name, value=f"{__name__}:{value}", group=GROUP)
            for name, value in values.items()
        ]
        monkeypatch.setattr(
            plugins, "entry_points", lambda group: [p for p in points if p.group == group]
        )
        _all_adapters.cache_clear()

    yield offer
    _all_adapters.cache_clear()


def test_a_folder_of_another_package_opens(tmp_path, installed):
    (tmp_path / "film.txt").touch()
    with pytest.raises(DataError, match="no scene found here"):
        open_scene(tmp_path, PROTOCOL)
    installed(film="FILM")
    assert len(open_scene(tmp_path, PROTOCOL).views) == len(tiny_scene().views)


def test_ours_are_asked_first(tmp_path, installed):
    folder = write_scene(tmp_path / "flight", Flight(views=4))
    installed(greedy="GREEDY")
    assert open_scene(folder, PROTOCOL).name == "flight"


def test_the_error_of_a_folder_that_nobody_knows_names_every_adapter(tmp_path, installed):
    installed(film="FILM")
    with pytest.raises(DataError) as caught:
        open_scene(tmp_path, PROTOCOL)
    for adapter in (*ADAPTERS, FILM):
        assert f"{adapter.name}: {adapter.looks_for}" in str(caught.value)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ({"colmap": "FILM"}, "the name is taken"),
        ({"film": "PROTOCOL"}, "expected a Adapter"),
        ({"film": "NOTHING"}, "cannot be loaded"),
        ({"movie": "FILM"}, "is called 'film'"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path, installed, points, said):
    installed(**points)
    with pytest.raises(UsageError, match=said) as caught:
        open_scene(tmp_path, PROTOCOL)
    assert next(iter(points)) in str(caught.value)
    assert GROUP in str(caught.value)


def wrong_open(folder, protocol):
    return {}["focal"]


def no_file(folder):
    return (folder / "nothing.json").read_text()


WRONG = dataclasses.replace(FILM, open=wrong_open)
BLIND = dataclasses.replace(FILM, recognises=no_file)
# what no adapter may return
SILENT = dataclasses.replace(FILM, open=lambda folder, protocol: None)  # pyrefly: ignore[bad-argument-type]


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("WRONG", r"fails on .*\(KeyError: 'focal'; test_adapter_plugins.py:\d+\); mend it"),
        ("BLIND", "fails on .*FileNotFoundError"),
        ("SILENT", "open gave a NoneType, expected a Scene"),
    ],
)
def test_one_that_fails_is_named_in_one_line(tmp_path, installed, value, said):
    (tmp_path / "film.txt").touch()
    installed(film=value)
    with pytest.raises(UsageError, match=f"^adapter film: {said}"):
        open_scene(tmp_path, PROTOCOL)


def test_doctor_lists_adapters(tmp_path, installed, capsys):
    installed(film="FILM")
    assert main(["doctor", "--json", "--out", str(tmp_path)]) == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    told = {one["name"]: one["found"] for one in found if one["topic"] == "scene adapters"}
    assert told == {adapter.name: adapter.looks_for for adapter in (*ADAPTERS, FILM)}


def test_doctor_says_what_is_wrong_with_an_adapter(tmp_path: Path, installed, capsys):
    installed(film="NOTHING")
    assert main(["doctor", "--json", "--out", str(tmp_path)]) == 3
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    faults = [one for one in found if one["status"] == "fault"]
    assert [one["topic"] for one in faults] == ["scene adapters"]
    assert "film" in faults[0]["fix"]
