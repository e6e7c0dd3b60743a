"""bench scenes: what it prints and how it ends."""

import json

import pytest

from splatproof import cli
from splatproof.datasets.catalogue import registry
from splatproof.datasets.procedural import courtyard


@pytest.fixture(autouse=True)
def places(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATPROOF_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    tiny = courtyard.Settings(width=48, height=36, oblique=3, nadir=(2, 1), samples=1)
    monkeypatch.setitem(courtyard.PRESETS, "small", tiny)
    return tmp_path


def run(*args):
    return cli.main(["scenes", *args])


def test_list(capsys):
    assert run("list") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["name", "kind", "licence", "present", "path"]
    assert len(lines) == 1 + len(registry.list_scenes())
    assert run("list", "--json") == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {tuple(record) for record in records} == {("name", "kind", "licence", "present", "path")}
    assert not any(record["present"] for record in records)


def names(capsys, *args):
    assert run("list", *args, "--json") == 0
    return [json.loads(line)["name"] for line in capsys.readouterr().out.splitlines()]


def test_list_can_be_narrowed(capsys, places):
    assert names(capsys, "city*") == ["city", "city/medium", "city/unseen"]
    assert set(names(capsys, "3das")) == set(names(capsys, "3das/*"))
    made = names(capsys, "--kind", "made")
    assert "courtyard" in made
    assert "seneca" not in made
    (places / "data" / "seneca").mkdir(parents=True)
    assert names(capsys, "--present") == ["seneca"]
    assert run("list", "nothing-of-that-name") == 2
    assert "'nothing-of-that-name'" in capsys.readouterr().err


def test_show(capsys, places):
    (places / "data" / "seneca").mkdir(parents=True)
    assert run("show", "seneca") == 0
    out = capsys.readouterr().out
    for part in ("CC0-1.0", "https://", str(places / "data" / "seneca"), "changed_files: sparse/0"):
        assert part in out
    assert run("show", "kitti_tracking/0001", "--json") == 0
    assert json.loads(capsys.readouterr().out)["present"] is False


def test_show_says_what_a_folder_holds(capsys, places):
    assert run("make", "courtyard", str(places / "mine")) == 0
    (places / "mine" / "photos" / "more.png").write_bytes(b"")
    capsys.readouterr()
    assert run("show", str(places / "mine"), "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["format"], found["photos"]) == ("colmap", 8)
    assert found["photos_by_size"] == {"48x36": 8}
    assert found["photos_with_true_depths"] == 8
    assert "sensors" not in found
    assert [one.partition(":")[0] for one in found["left_out"]] == ["more.png"]
    assert run("show", str(places / "mine")) == 0
    assert "photos_by_size: 48x36 8" in capsys.readouterr().out
    (places / "empty").mkdir()
    assert run("show", str(places / "empty")) == 2
    assert "no scene found here; looked for" in capsys.readouterr().err


def test_get_makes_a_made_scene(capsys):
    assert run("get", "courtyard", "--quiet") == 0
    path = capsys.readouterr().out.strip()
    assert path == str(registry.find_scene("courtyard"))
    assert run("get", "courtyard", "--json", "--quiet") == 0
    assert json.loads(capsys.readouterr().out)["path"] == path


def test_make(capsys, places):
    out = places / "mine"
    assert run("make", "courtyard", str(out), "--seed", "5", "--quiet") == 0
    assert (out / "sparse" / "0" / "images.bin").exists()
    assert 'seed" = "5"' in (out / "scene.toml").read_text()


def test_a_world_that_nobody_names_a_folder_for_says_where_it_went(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("splatproof.datasets.procedural.worlds.make", lambda *args: args[3])
    assert run("make", "city", "--seed", "5") == 0
    said = capsys.readouterr()
    assert said.out.strip() == "city-small-5"
    assert "bench fit auto city-small-5 --out MODEL --seconds 60" in said.err


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (("get", "waymo_pvg/0145050"), 3, "looked for"),
        (("get", "waymo_pvg/014505"), 2, "did you mean 'waymo_pvg/0145050'"),
        (("show", "nowhere"), 2, "bench scenes list"),
        (("make", "village"), 2, "there are courtyard"),
        (("make", "village", "x"), 2, "there are courtyard"),
        (("make", "courtyard", "x", "--preset", "huge"), 2, "small, medium, large"),
        (("make", "courtyard", "x", "--seed", "-1"), 2, "--seed is -1, expected from 0"),
        (("make", "courtyard", "."), 2, "exists and is not this scene"),
    ],
)
def test_what_goes_wrong_is_told_in_one_line(capsys, args, code, words):
    assert run(*args) == code
    out, err = capsys.readouterr()
    assert not out
    assert words in err
    assert len(err.strip().splitlines()) == 1
