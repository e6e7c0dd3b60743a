"""bench doctor: what is there, what is missing, and exit code 3 where something essential is."""

import json

import pytest
import torch

from helpers.plugin_metrics import BRIGHTNESS
from helpers.random_weights import forget, write_weights
from splatproof import _ext
from splatproof.base.errors import UsageError
from splatproof.cli import main
from splatproof.methods.contracts import backends
from splatproof.metrics import registry
from splatproof.reference.rasterizer.rasterize import rasterize


def findings(capsys) -> dict[str, dict[str, str]]:
    lines = capsys.readouterr().out.splitlines()
    return {record["name"]: record for record in map(json.loads, lines)}


def test_everything_is_named_and_nothing_is_written(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    out = tmp_path / "runs"
    assert main(["doctor", "--json", "--out", str(out)]) == 0
    found = findings(capsys)
    assert {"splatproof", "torch", "cpu", "reference", "cuda", "courtyard", "cache"} <= set(found)
    assert found["simd"]["found"] == _ext.simd_level()
    assert found["torch"]["status"] == "ok"
    assert found["tracking store"]["found"].startswith("sqlite:///")
    assert not out.exists()


def test_what_is_absent_says_how_to_get_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("SPLATPROOF_DATA", str(tmp_path / "nowhere"))
    assert main(["doctor", "--json", "--out", str(tmp_path)]) == 0
    found = findings(capsys)
    assert found["brighton_beach"]["status"] == "absent"
    for record in found.values():
        assert (record["status"] == "ok") == (record["fix"] == "")


def test_weights_are_looked_for_where_the_variable_says(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    forget()
    monkeypatch.setenv("SPLATPROOF_WEIGHTS", str(tmp_path / "mine"))
    sha = write_weights(tmp_path / "mine", "alex", monkeypatch)
    assert main(["doctor", "--json", "--out", str(tmp_path)]) == 0
    found = findings(capsys)
    assert (
        found["lpips_alex_m11"] | {"found": f"sha256 {sha}", "fix": ""} == found["lpips_alex_m11"]
    )
    assert found["lpips_vgg_m11"]["status"] == "absent"
    assert "SPLATPROOF_WEIGHTS" in found["lpips_vgg_m11"]["fix"]
    forget()


def test_metrics_of_other_packages_are_named_and_a_broken_one_is_a_fault(
    tmp_path, capsys, monkeypatch
):
    both = registry.BUILT_IN | {"brightness": BRIGHTNESS}
    monkeypatch.setattr(registry, "all_metrics", lambda: both)
    assert main(["doctor", "--json", "--out", str(tmp_path)]) == 0
    assert findings(capsys)["brightness"]["found"] == "another package's own"

    def broken():
        raise UsageError("package odd: entry point dim = odd:dim: cannot be loaded")

    monkeypatch.setattr(registry, "all_metrics", broken)
    assert main(["doctor", "--json", "--out", str(tmp_path)]) == 3
    found = findings(capsys)
    assert "package odd" in found["splatproof.metrics"]["fix"]
    assert "lpips_vgg_m11" in found


def test_a_backend_that_is_essential_is_a_fault(tmp_path, capsys, monkeypatch):
    broken = backends.Backend(
        name="cpu",
        rasterize=rasterize,
        capabilities=frozenset(),
        missing="run `pip install .`",
    )
    monkeypatch.setitem(backends.BACKENDS, "cpu", lambda: broken)
    assert main(["doctor", "--out", str(tmp_path)]) == 3
    said = capsys.readouterr()
    assert " ! cpu" in said.out
    assert "pip install ." in said.out
    assert "1 fault" in said.err


def test_a_folder_that_cannot_be_written_is_a_fault(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["doctor", "--json", "--out", str(tmp_path / "file")]) == 3
    assert findings(capsys)["runs"]["status"] == "fault"


@pytest.mark.parametrize("uri", ["http://127.0.0.1:9", "some/folder"])
def test_a_store_that_does_not_answer_is_said(tmp_path, capsys, monkeypatch, uri):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    assert main(["doctor", "--json", "--out", str(tmp_path)]) == 0
    found = findings(capsys)["tracking store"]
    assert found["status"] == "absent"
    assert found["fix"]
