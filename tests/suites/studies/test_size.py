"""The size study: rows that agree with each other, and the picture."""

import pytest
import torch

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import MissingError
from splatproof.methods.compression.tuning import TuneSettings
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.morton import morton_order
from splatproof.methods.storage.packed.writer import PARTS
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites.studies import size, size_formats, size_images, size_page, size_plot
from splatproof.suites.studies.study import STUDIES


@pytest.fixture(scope="module")
def rows(tmp_path_factory) -> dict[str, dict]:
    folder = tmp_path_factory.mktemp("size")
    scene, protocol = tiny_scene(), load_protocol("default")
    fitted = ExplicitModel(model=random_gaussians(300, degree=3))
    base = size.quality(scene, fitted, fitted.model, protocol)["psnr"]
    found = [
        size.row(kind, scene, fitted, base, protocol, folder / "m")
        for kind in size_formats.formats()
        if not kind.name.startswith("spz 4")
    ]
    return {row["format"]: {"scene": "tiny", "psnr": base, "steps": 1} | row for row in found}


def test_lossless_formats_lose_nothing_and_the_others_little(rows):
    for name in ("ply", "safetensors"):
        assert rows[name]["psnr_change"] == 0
        assert rows[name]["psnr_to_model"] == float("inf")
    for row in rows.values():
        assert row["psnr_to_model"] > (25 if row["curve"] != "png grid" else 15)
    assert rows["codes alone"]["psnr_to_model"] < float("inf")


def test_sizes_are_those_of_the_formats(rows):
    assert rows["ply"]["bytes_each"] > 248  # 62 floats
    assert 236 < rows["safetensors"]["bytes_each"] < 240  # 59 floats, and the header
    row = rows["codes alone"]
    assert 79 < row["bytes_each"] - row["kept"] < 84  # the release's 79, and header and lattice
    for row in rows.values():
        if "positions" in row:
            assert sum(row.get(part, 0) for part in PARTS) < row["bytes_each"]
    assert rows["codes alone"]["psnr_change"] == rows["+ zstd"]["psnr_change"]
    gates = [rows[f"gate {gate}"]["bytes"] for gate in size_formats.GATES[1:]]
    assert gates == sorted(gates, reverse=True)
    ours = [rows[f"small {step}"] for step in size_formats.HARMONICS]
    assert [row["bytes"] for row in ours] == sorted((row["bytes"] for row in ours), reverse=True)
    assert [row["psnr_to_model"] for row in ours] == sorted(
        (row["psnr_to_model"] for row in ours), reverse=True
    )
    assert rows["standard"]["bytes"] < rows["gate 0.08"]["bytes"]
    # of 300 Gaussians each has an entry of 1,024, and not each of 256
    assert rows["sog 1024"]["bytes"] == rows["sog 4096"]["bytes"] > rows["sog"]["bytes"]
    assert rows["sog 1024"]["psnr_to_model"] > rows["sog"]["psnr_to_model"]


def test_the_picture_is_drawn_from_rows_with_a_size(rows, tmp_path):
    assert size_plot.draw([{"scene": "a", "format": "spz 3", "note": "missing"}], tmp_path) == []
    (path,) = size_plot.draw(list(rows.values()), tmp_path)
    assert path.name == "size_held-out.png"
    assert path.stat().st_size > 10_000
    seen = [row | {"seen_change": row["psnr_change"]} for row in rows.values()]
    assert len(size_plot.draw(seen, tmp_path)) == 2


def test_the_page_says_what_the_rows_say(rows):
    missing = {"scene": "nowhere", "format": "", "note": "no scene found"}
    text = size_page.page({"cpu": "abacus"}, [*rows.values(), missing], ["images/size/size.png"])
    for said in ("abacus", "](images/size/size.png)", "## tiny", "nowhere: no scene found"):
        assert said in text
    line = next(line for line in text.splitlines() if line.startswith("| standard |"))
    assert f"{rows['standard']['bytes_each']:.1f}" in line
    assert f"{rows['standard']['psnr_change']:+.3f}" in line


def test_a_format_that_is_not_installed_is_a_note(tmp_path):
    def missing(*_):
        raise MissingError("no package gsply")

    kind = size_formats.Format(name="spz 3", curve="spz 3", write=missing, read=missing)
    fitted = ExplicitModel(model=random_gaussians(3))
    row = size.row(kind, tiny_scene(), fitted, 0.0, load_protocol("default"), tmp_path / "m")
    assert "gsply" in row["note"]
    assert "bytes" not in row


@pytest.mark.slow
def test_the_quick_form_runs_on_any_machine():
    rows = list(STUDIES["size"].rows(quick=True))
    assert {row["format"] for row in rows} == {kind.name for kind in size_formats.formats()}
    assert all(torch.tensor(row["psnr_change"]).isfinite() for row in rows if "bytes" in row)


def test_images_hold_the_model_within_their_levels(tmp_path):
    model = random_gaussians(70, degree=2)
    size_images.write_images(tmp_path / "m", model, bits=8)
    back = size_images.read_images(tmp_path / "m")
    order = morton_order(model.means)
    for name in ("means", "log_scales", "sh"):
        want = getattr(model, name)[order]
        reach = float(want.max() - want.min())
        assert (getattr(back, name) - want).abs().max() <= reach / 510 * 1.01, name
    assert (
        back.opacity_logits.sigmoid() - model.opacity_logits[order].sigmoid()
    ).abs().max() < 0.003


def test_models_with_fewer_gaussians_and_tuned_ones_are_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(size, "TuneSettings", lambda: TuneSettings(iterations=2))
    scene, fitted = tiny_scene(), ExplicitModel(model=random_gaussians(40, degree=1))
    found = {}
    for kind in size.smaller_formats(scene, fitted, load_protocol("default")):
        kind.write(tmp_path / "m", fitted.model)
        found[kind.name] = len(kind.read(tmp_path / "m"))
        assert kind.curve in size_plot.CURVES
    assert found["pruned 0.1"] == found["merged 0.1"] == 36
    assert found["tuned 0.3, coarse"] == 28
    assert found["tuned 0.5, coarse"] == found["merged 0.5"] == 20


@pytest.mark.parametrize(("losses", "end"), [((0.0, 0.5), -0.05), ((-0.143, 0.5), -0.1716)])
def test_files_that_gain_are_within_the_picture(losses, end):
    assert size_plot.lowest_shown(losses) == pytest.approx(end)
    assert size_plot.lowest_shown(losses) < min(losses)


def test_the_smallest_files_that_lose_next_to_nothing_are_named_by_either_set_of_views():
    def made(name: str, curve: str, size: float, held: float, seen: float) -> dict:
        return {"scene": "a", "format": name, "curve": curve, "bytes_each": size, "psnr_change": held,
                "seen_change": seen, "steps": 1, "primitives": 1, "psnr": 20.0}  # fmt: skip

    rows = [
        made("fine", "ours, small", 20.0, 0.0, -0.1), made("coarse", "ours, small", 10.0, -0.05, -0.2),
        made("coarser", "ours, small", 5.0, -0.3, -0.4), made("spz 4", "spz 4", 9.0, -0.5, -0.5),
    ]  # fmt: skip
    text = size_page.page({}, rows, [])
    assert "| a, held-out | 10.0 (`coarse`) | – | – | – | – | – |" in text
    assert "| a, training | 20.0 (`fine`) | – | – | – | – | – |" in text
