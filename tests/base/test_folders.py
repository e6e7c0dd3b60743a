"""Folders that are there whole or not at all."""

import pytest

from splatproof.base.folders import new_folder, working_folder


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "model"
    with new_folder(target) as folder:
        (folder / "a").write_text("old")
        assert not target.exists()
    with pytest.raises(IsADirectoryError), new_folder(target) as folder:  # noqa: PT012
        (folder / "a").mkdir()
        (folder / "a").write_text("half")
    assert (target / "a").read_text() == "old"
    (tmp_path / "model.partial").mkdir()
    (tmp_path / "model.partial" / "rubbish").write_text("of a kill")
    with new_folder(target) as folder:
        (folder / "b").write_text("new")
    assert [path.name for path in target.iterdir()] == ["b"]
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_a_working_folder_begins_empty_and_leaves_nothing(tmp_path):
    (tmp_path / "scene.partial").mkdir()
    (tmp_path / "scene.partial" / "rubbish").write_text("of a kill")
    with pytest.raises(KeyboardInterrupt), working_folder(tmp_path / "scene") as folder:  # noqa: PT012
        assert not list(folder.iterdir())
        (folder / "half").write_text("")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())
