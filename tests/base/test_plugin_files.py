"""Plug-in files: run once by content, found by pickle, refused by name and line."""

import pickle
import sys
from pathlib import Path

import pytest

from splatproof.base import plugin_files
from splatproof.base.errors import UsageError
from splatproof.base.plugin_files import Brought, load_plugin_file
from splatproof.base.plugins import with_plugins

GROUP = "splatproof.test"
SOURCE = """
from dataclasses import dataclass

@dataclass(frozen=True)
class Thing:
    name: str

ONE = Thing("one")
"""


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch):
    """No file is loaded; what others had loaded is there afterwards."""
    monkeypatch.setattr(plugin_files, "_loaded", {})
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.startswith(plugin_files.PREFIX):
            del sys.modules[name]


def written(folder: Path, text: str = SOURCE, name: str = "mine.py") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def test_what_it_has_stands_beside_what_is_built_in(tmp_path):
    file = load_plugin_file(str(written(tmp_path)))
    kind = file.module.Thing
    ours = kind("ours")
    table = with_plugins({"ours": ours}, GROUP, kind)
    assert table == {"ours": ours, "one": file.module.ONE}
    assert with_plugins({}, GROUP, float) == {}


def test_a_taken_name_is_refused_and_the_very_same_object_is_not(tmp_path):
    file = load_plugin_file(written(tmp_path))
    kind = file.module.Thing
    with pytest.raises(UsageError, match=r"mine\.py: its Thing is called 'one', .*taken"):
        with_plugins({"one": kind("one")}, GROUP, kind)
    assert with_plugins({"one": file.module.ONE}, GROUP, kind) == {"one": file.module.ONE}


def test_it_is_run_again_only_when_it_has_changed(tmp_path):
    path = written(tmp_path)
    first = load_plugin_file(path)
    kind = first.module.Thing
    assert load_plugin_file(path) is first
    assert first.module.Thing is kind
    written(tmp_path, SOURCE + "TWO = Thing('two')\n")
    second = load_plugin_file(path)
    assert second.sha256 != first.sha256
    assert plugin_files.plugin_files() == (second,)
    assert second.module.TWO.name == "two"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = 1\nraise ValueError('no')\n", r"mine\.py:2: cannot be loaded \(ValueError"),
        ("x = 1\n\ndef f(:\n", r"mine\.py:3: cannot be loaded \(SyntaxError"),
        ("import no_such_module\n", r"mine\.py:1: cannot be loaded \(ModuleNotFoundError"),
    ],
)
def test_what_cannot_be_run_is_told_with_its_line(tmp_path, text, said):
    with pytest.raises(UsageError, match=said):
        load_plugin_file(written(tmp_path, text))
    assert plugin_files.plugin_files() == ()
    assert f"{plugin_files.PREFIX}mine" not in sys.modules


def test_a_spoilt_change_leaves_what_was_there(tmp_path):
    file = load_plugin_file(written(tmp_path))
    with pytest.raises(UsageError, match=":1: cannot be loaded"):
        load_plugin_file(written(tmp_path, "1 / 0\n"))
    assert file.module.ONE.name == "one"
    assert plugin_files.plugin_files() == (file,)


@pytest.mark.parametrize("name", ["mine.txt", "my-file.py", "missing.py"])
def test_a_file_that_cannot_be_one_is_named(tmp_path, name):
    if name != "missing.py":
        written(tmp_path, name=name)
    with pytest.raises(UsageError, match=f"{name}: "):
        load_plugin_file(tmp_path / name)


def test_two_files_of_one_name_are_refused(tmp_path):
    load_plugin_file(written(tmp_path / "a"))
    with pytest.raises(UsageError, match="has the same name; rename one"):
        load_plugin_file(written(tmp_path / "b"))


def test_pickle_brings_the_files_before_what_is_made_of_them(tmp_path):
    path = written(tmp_path)
    one = load_plugin_file(path).module.ONE
    sent = pickle.dumps((Brought(), one))
    plugin_files._loaded.clear()
    del sys.modules[f"{plugin_files.PREFIX}mine"]
    _, one = pickle.loads(sent)
    assert one == plugin_files.plugin_files()[0].module.ONE
    plugin_files._loaded.clear()
    del sys.modules[f"{plugin_files.PREFIX}mine"]
    written(tmp_path, SOURCE + "# another\n")
    with pytest.raises(UsageError, match="changed while it was at work"):
        pickle.loads(sent)
