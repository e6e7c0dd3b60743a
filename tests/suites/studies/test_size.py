"""The size study: rows that agree with each other, and the picture."""

import pytest
import torch

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import MissingError
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.packed.writer import PARTS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites.studies import size, size_plot
from splatproof.suites.studies.study import STUDIES


@pytest.fixture(scope="module")
def rows(tmp_path_factory) -> dict[str, dict]:
    folder = tmp_path_factory.mktemp("size")
    scene, protocol = tiny_scene(), load_protocol("default")
    fitted = ExplicitModel(model=random_gaussians(300, degree=3))
    base = size.quality(scene, fitted, fitted.model, protocol)["psnr"]
    found = [
        size.row(kind, scene, fitted, base, protocol, folder / "m")
        for kind in size.formats()
        if not kind.name.startswith("spz 4")
    ]
    return {row["format"]: {"scene": "tiny", "psnr": base} | row for row in found}


def test_lossless_formats_lose_nothing_and_the_others_little(rows):
    for name in ("ply", "safetensors"):
        assert rows[name]["psnr_change"] == 0
        assert rows[name]["psnr_to_model"] == float("inf")
    for row in rows.values():
        assert row["psnr_to_model"] > 25
    assert rows["codes alone"]["psnr_to_model"] < float("inf")


def test_sizes_are_those_of_the_formats(rows):
    assert rows["ply"]["bytes_each"] > 248  # 62 floats
    assert 236 < rows["safetensors"]["bytes_each"] < 240  # 59 floats, and the header
    row = rows["codes alone"]
    assert 79 < row["bytes_each"] - row["kept"] < 84  # the release's 79, and header and lattice
    for row in rows.values():
        if "positions" in row:
            assert sum(row[part] for part in PARTS) < row["bytes_each"]
    assert rows["codes alone"]["psnr_change"] == rows["+ zstd"]["psnr_change"]
    gates = [rows[f"gate {gate}"]["bytes"] for gate in size.GATES]
    assert gates == sorted(gates, reverse=True)


def test_the_picture_is_drawn_from_rows_with_a_size(rows, tmp_path):
    assert size_plot.draw([{"format": "spz 3", "note": "missing"}], tmp_path) == []
    (path,) = size_plot.draw(list(rows.values()), tmp_path)
    assert path.stat().st_size > 10_000


def test_a_format_that_is_not_installed_is_a_note(tmp_path):
    def missing(*_):
        raise MissingError("no package gsply")

    kind = size.Format(name="spz 3", gate=None, write=missing, read=missing)
    fitted = ExplicitModel(model=random_gaussians(3))
    row = size.row(kind, tiny_scene(), fitted, 0.0, load_protocol("default"), tmp_path / "m")
    assert "gsply" in row["note"]
    assert "bytes" not in row


@pytest.mark.slow
def test_the_quick_form_runs_on_any_machine():
    rows = list(STUDIES["size"].rows(quick=True))
    assert {row["format"] for row in rows} == {kind.name for kind in size.formats()}
    assert all(torch.tensor(row["psnr_change"]).isfinite() for row in rows if "bytes" in row)
