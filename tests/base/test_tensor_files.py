"""Tensors on disk: what comes back, and faults in one line."""

import errno
from pathlib import Path

import pytest
import torch
from safetensors import SafetensorError

from splatproof.base import tensor_files
from splatproof.base.errors import DataError


def test_tensors_and_facts_come_back(tmp_path):
    path = tmp_path / "new" / "a.safetensors"
    tensors = {"b": torch.arange(6).reshape(2, 3).mT, "empty": torch.zeros(0, 3)}
    tensor_files.write_tensors(path, tensors, {"step": 3})
    found, facts = tensor_files.read_tensors(path)
    assert facts == {"step": 3}
    assert {name: t.tolist() for name, t in found.items()} == {
        name: t.tolist() for name, t in tensors.items()
    }


@pytest.mark.parametrize(
    ("cut", "match"), [(None, "no such file"), (20, "not a whole safetensors")]
)
def test_a_file_that_is_not_whole_is_named(tmp_path, cut, match):
    path = tmp_path / "a.safetensors"
    if cut is not None:
        tensor_files.write_tensors(path, {"a": torch.zeros(100)})
        path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(DataError, match=rf"a\.safetensors: {match}") as caught:
        tensor_files.read_tensors(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(DataError, match=rf"a\.safetensors: {match}.*; remove it$"):
        tensor_files.read_tensors(path, "remove it")


def test_tensors_that_find_no_room_name_their_file(tmp_path, monkeypatch):
    def save(tensors: object, path: Path, **_: object) -> None:
        path.write_bytes(b"half")
        raise SafetensorError("I/O error: No space left on device (os error 28)")  # on a full tmpfs

    monkeypatch.setattr(tensor_files, "save_file", save)
    with pytest.raises(OSError, match=r"model\.safetensors") as caught:
        tensor_files.write_tensors(tmp_path / "model.safetensors", {"a": torch.zeros(10)})
    assert caught.value.errno == errno.ENOSPC
    assert not list(tmp_path.iterdir())
