"""The registry: what stands in it, where scenes are looked for, what is said when they are away."""

import hashlib
import os
import zipfile

import pytest

from helpers.file_server import served
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.datasets.catalogue import registry
from splatproof.metrics.protocol_files import protocol_names


@pytest.fixture
def roots(tmp_path, monkeypatch):
    paths = [tmp_path / "one", tmp_path / "two"]
    monkeypatch.setenv("SPLATPROOF_DATA", os.pathsep.join(map(str, paths)))
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    for path in paths:
        path.mkdir()
    return paths


def test_every_entry_says_what_a_user_needs():
    entries = registry.list_scenes()
    assert len({e.name for e in entries}) == len(entries) > 20
    for entry in entries:
        assert entry.about
        assert entry.source
        assert entry.licence
        assert entry.folders
        if entry.kind == "made":
            assert entry.world
        else:
            assert entry.home.startswith("https://") or "names no page" in entry.get
            assert entry.get or (entry.url and entry.sha256)


def test_a_scene_is_found_in_the_first_root_that_has_it(roots):
    (roots[1] / "seneca").mkdir()
    assert registry.find_scene("seneca") == roots[1] / "seneca"
    (roots[0] / "seneca").mkdir()
    assert registry.find_scene("seneca") == roots[0] / "seneca"


def test_another_folder_name_of_a_public_scene(roots):
    (roots[0] / "rubble-pixsfm").mkdir()
    assert registry.find_scene("mill19/rubble") == roots[0] / "rubble-pixsfm"


def test_an_unknown_name_gets_the_nearest_one(roots):
    with pytest.raises(UsageError, match="did you mean 'brighton_beach'") as caught:
        registry.find_scene("brigton_beech")
    assert caught.value.exit_code == 2


def test_a_scene_that_is_away_says_where_it_was_looked_for_and_how_to_get_it(roots):
    with pytest.raises(MissingError) as caught:
        registry.find_scene("mill19/building")
    message = str(caught.value)
    for part in (*map(str, roots), "building-pixsfm", "SPLATPROOF_DATA", "https://"):
        assert part in message
    assert "\n" not in message
    assert caught.value.exit_code == 3


def test_default_roots(monkeypatch):
    monkeypatch.delenv("SPLATPROOF_DATA", raising=False)
    assert [str(root) for root in registry.data_roots()] == ["data", "../shared/data"]


ENTRY = """
[mine]
kind = "real"
licence = "CC0-1.0"
source = "us"
about = "a test"
home = "https://example.org"
"""


def test_a_data_root_adds_scenes_and_wins(roots):
    (roots[1] / "registry.toml").write_text(ENTRY + ENTRY.replace("mine", "courtyard"))
    assert registry.get_entry("mine").source == "us"
    assert registry.get_entry("courtyard").kind == "real"


def test_folders_of_a_set_name_its_scenes(roots):
    more = 'folders = ["one/<scene>", "<scene>-two"]\nscenes = ["a", "b/c"]\n'
    (roots[1] / "registry.toml").write_text(ENTRY + more)
    assert registry.get_entry("mine/b/c").folders == ("one/b/c", "b/c-two")
    (roots[0] / "a-two").mkdir()
    assert registry.find_scene("mine/a") == roots[0] / "a-two"


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[mine\n", "not a TOML"),
        ("mine = 3", "expected a table"),
        (ENTRY.replace('kind = "real"', 'kind = "odd"'), "kind: .*found 'odd'"),
        (ENTRY.replace('about = "a test"', ""), "about is missing"),
        (ENTRY + "colour = 3", "unknown 'colour'"),
        (ENTRY.replace('"us"', "3"), "source: .*found 3"),
        (ENTRY + 'url = "https://example.org/x.zip"', "both url and sha256"),
    ],
)
def test_a_wrong_registry_file_is_told_in_one_line(roots, text, match):
    (roots[0] / "registry.toml").write_text(text)
    with pytest.raises(DataError, match=match) as caught:
        registry.list_scenes()
    assert "\n" not in str(caught.value)


def test_changed_files_are_named(roots):
    folder = roots[0] / "mine"
    folder.mkdir()
    (folder / "a").write_bytes(b"1")
    digest = hashlib.sha256(b"1").hexdigest()
    entry = registry.SceneEntry(
        name="mine", kind="real", licence="x", source="x", about="x",
        files={"a": digest, "b": digest},
    )  # fmt: skip
    assert registry.changed_files(entry, folder) == ["b"]
    (folder / "a").write_bytes(b"2")
    assert registry.changed_files(entry, folder) == ["a", "b"]


def test_get_downloads_checks_and_unpacks(roots, tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as packed:
        packed.writestr("inner/photos/x.png", b"pixels")
    body = (tmp_path / "a.zip").read_bytes()
    digest = hashlib.sha256(body).hexdigest()
    with served(body) as server:
        link = f'url = "{server.url}"\nsha256 = "{digest}"'
        (roots[0] / "registry.toml").write_text(ENTRY + link)
        path = registry.fetch_entry(registry.get_entry("mine"))
    assert path == registry.find_scene("mine") == roots[0] / "mine"
    assert (path / "photos/x.png").read_bytes() == b"pixels"
    assert not list(roots[0].glob(".*archive*"))


def test_protocols_of_a_scene_exist_and_its_own_name_stands_in_what_to_do():
    for entry in registry.list_scenes():
        assert set(entry.protocols) <= set(protocol_names())
        assert entry.protocols or entry.kind != "public"
        assert registry.SCENE not in entry.get
    assert "mill19/rubble below" in registry.get_entry("mill19/rubble").get


def test_get_by_hand(roots):
    with pytest.raises(MissingError, match="register and download"):
        registry.fetch_entry(registry.get_entry("kitti_tracking/0001"))


def test_scenes_of_one_world_share_its_folder(roots):
    church, town = (registry.get_entry(f"aerial-sparse/{kind}") for kind in ("church", "town"))
    assert registry.made_folder(church) == registry.made_folder(town)
    registry.made_folder(church).mkdir(parents=True)
    assert registry.find_scene("aerial-sparse/town") == registry.made_folder(town) / "town"


@pytest.mark.parametrize("path", ["/nowhere", "./nowhere", "../nowhere"])
def test_a_folder_that_is_not_there_is_likened_to_no_scene(path):
    with pytest.raises(UsageError, match=rf"^{path}: no such folder; `bench scenes list`"):
        registry.get_entry(path)
