"""`--quiet` silences what other rooms show while a scene is made."""

import pytest

from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError
from splatproof.cli import main
from splatproof.datasets.procedural import worlds
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.models.explicit import ExplicitModel


@pytest.mark.parametrize("command", ["render", "gallery"])
def test_a_scene_that_is_made_first_is_made_quietly(command, tmp_path, monkeypatch, capsys):
    def stopped(*_: object) -> None:
        raise DataError("stopped")

    monkeypatch.setattr(worlds, "make", stopped)
    monkeypatch.setenv("SPLATPROOF_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("SPLATPROOF_CACHE", str(tmp_path / "cache"))
    save_model(ExplicitModel(model=random_gaussians(5)), tmp_path / "model", Origin())
    arguments = {
        "render": [str(tmp_path / "model"), "out", "--scene", "courtyard", "--protocol", "default"],
        "gallery": ["out", "--scene", "courtyard"],
    }
    for more, said in (([], ["making the world courtyard"]), (["--quiet"], [])):
        assert main([command, *arguments[command], *more]) == 2
        assert capsys.readouterr().err.splitlines() == [*said, "bench: stopped"]
