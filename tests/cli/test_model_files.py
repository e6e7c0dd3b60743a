"""Files of Gaussians stand wherever a model folder does: written, rendered and scored from a camera source."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from helpers.tiny_scene import camera, random_gaussians, tiny_scene
from splatproof.cli import main
from splatproof.datasets.catalogue import opening
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.loading import load_origin, load_reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.spz import read_spz
from splatproof.reference.types.scene import camera_view

KINDS = {"ply": ".ply", "spz": ".spz", "sog": ".sog", "gltf": ".glb", "packed": ".spgs"}
# what a PNG can differ by, of 255, and the mean over it: .ply and .glb hold float32; .spz 8 bits of
# colour and opacity, 5 and 4 of the harmonics; .sog 32 entries for the harmonics of 40; a packed file steps of 0.025 of a scale, 10 % of a
# radius, 0.05 in colour and in what depends on the view, as its defaults are
WORST = {"ply": (0, 0.0), "gltf": (1, 0.01), "spz": (24, 2.5), "sog": (32, 2.5), "packed": (8, 1.0)}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A model folder of the tiny scene's own Gaussians, and each kind of file of it."""
    folder = tmp_path_factory.mktemp("files")
    model = ExplicitModel(model=random_gaussians(40), backend="reference")
    save_model(model, folder / "model", Origin())
    options = [
        part for kind, suffix in KINDS.items() for part in (f"--{kind}", str(folder / f"m{suffix}"))
    ]
    assert main(["export", str(folder / "model"), *options, "--quiet"]) == 0
    where = camera(0)
    entry = {"name": "0.png", "width": where.width, "height": where.height,
             "K": where.K.tolist(), "world_to_camera": where.world_to_camera.tolist()}  # fmt: skip
    (folder / "cameras.json").write_text(json.dumps([entry]))
    return folder


def picture(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return image.astype(int)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_rendered_from_a_file_of_cameras(written, kind, tmp_path):
    cameras = ["--cameras", str(written / "cameras.json"), "--backend", "reference"]
    for model, out in (("model", "want"), (f"m{KINDS[kind]}", "got")):
        assert main(["render", str(written / model), str(tmp_path / out), *cameras]) == 0
    off = np.abs(picture(tmp_path / "got" / "0.png") - picture(tmp_path / "want" / "0.png"))
    worst, mean = WORST[kind]
    assert off.max() <= worst
    assert off.mean() <= mean


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_exported_again_and_keeps_the_mode(kind, tmp_path, capsys):
    model = ExplicitModel(model=random_gaussians(40), mode="antialiased")
    save_model(model, tmp_path / "model", Origin())
    first, again = tmp_path / f"m{KINDS[kind]}", tmp_path / "again.ply"
    assert main(["export", str(tmp_path / "model"), f"--{kind}", str(first)]) == 0
    said = capsys.readouterr().err
    assert main(["export", str(first), "--ply", str(again), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["gaussians"] == 40
    # viewers of .sog heed it
    assert ("antialiased" in said) == (kind not in ("packed", "sog"))
    loaded = load_reconstruction(again)
    assert isinstance(loaded, ExplicitModel)
    assert loaded.mode == "antialiased"


@pytest.mark.parametrize(("far", "said"), [(1.0, ""), (1e5, "1 of 400 Gaussians")])
def test_a_packed_file_that_one_far_gaussian_makes_coarser_says_so(tmp_path, capsys, far, said):
    model = random_gaussians(400)
    model.means[7] = torch.tensor([0.0, -far, 0.0])
    save_model(ExplicitModel(model=model), tmp_path / "model", Origin())
    packed = str(tmp_path / "m.spgs")
    assert main(["export", str(tmp_path / "model"), "--packed", packed]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "as coarse as asked" in line]
    assert len(lines) == bool(said)
    assert all(said in line and "the farthest 100000;" in line for line in lines)
    assert all(line.startswith(packed) for line in lines)


def test_what_an_spz_clips_is_counted_in_a_line(tmp_path, capsys):
    model = random_gaussians(40)
    model.sh.clamp_(-0.9, 0.9)
    path = str(tmp_path / "m.spz")
    for clips in (False, True):
        if clips:
            model.log_scales[0, 1], model.log_scales[7, 0] = -11.1, 6.9
            model.sh[4, 0, 2], model.sh[5, 2, 0] = 5.0, 1.7
        save_model(ExplicitModel(model=model), tmp_path / "model", Origin())
        assert main(["export", str(tmp_path / "model"), "--spz", path]) == 0
        lines = [line for line in capsys.readouterr().err.splitlines() if "clipped" in line]
        assert len(lines) == clips
    assert lines[0].startswith(path)
    assert "clipped: log scales of 2, colours of 1, harmonics of 1;" in lines[0]


@pytest.mark.parametrize(
    ("logits", "said"),
    [((), ""), ((-9.0, -9.0, 9.0), "of 40 opacities a .sog stores 2 as 0 and 1 as 1, its nearest of 256; a .ply")],
)  # fmt: skip
def test_opacities_that_a_sog_stores_as_0_and_1_are_counted_in_a_line(
    tmp_path, capsys, logits, said
):
    model = random_gaussians(40)
    model.opacity_logits.clamp_(-3, 3)
    model.opacity_logits[: len(logits)] = torch.tensor(logits)
    save_model(ExplicitModel(model=model), tmp_path / "model", Origin())
    path = str(tmp_path / "m.sog")
    assert main(["export", str(tmp_path / "model"), "--sog", path, "--json"]) == 0
    out, err = capsys.readouterr()
    line = json.loads(out)
    assert (line["sog"], line["gaussians"], line["view"]) == (path, 40, None)
    assert line["bytes"] == Path(path).stat().st_size
    lines = [line for line in err.splitlines() if "opacities" in line]
    assert len(lines) == bool(said)
    assert all(line.startswith(f"{path}: {said}") for line in lines)


def test_a_palette_that_takes_long_is_told_before_it(tmp_path, capsys, monkeypatch):
    save_model(ExplicitModel(model=random_gaussians(40)), tmp_path / "model", Origin())
    for most, lines in ((40, 0), (39, 1)):
        monkeypatch.setattr("splatproof.cli.export.MANY", most)
        assert main(["export", str(tmp_path / "model"), "--sog", str(tmp_path / "m.sog")]) == 0
        assert capsys.readouterr().err.count("a palette for the harmonics of 40") == lines


@pytest.mark.parametrize(
    ("far", "said"),
    [(10.0, ""), (1e6, "in steps of 0.125, "), (5e6, "positions up to 5e+06; .spz holds less")],
)
def test_a_far_gaussian_that_makes_an_spz_coarse_is_told(tmp_path, capsys, far, said):
    """One of 1e6 left the others an eighth of a unit without a word, and of 5e6 the package failed."""
    model = random_gaussians(40)
    model.means[0, 0] = far
    save_model(ExplicitModel(model=model), tmp_path / "model", Origin())
    path = str(tmp_path / "m.spz")
    assert main(["export", str(tmp_path / "model"), "--spz", path]) == (2 if far > 2**22 else 0)
    lines = [line for line in capsys.readouterr().err.splitlines() if "positions" in line]
    assert len(lines) == bool(said)
    assert all(f"{path}: positions" in line and said in line for line in lines)


@pytest.mark.parametrize(("words", "few"), [((), False), (("--quality=coarse",), True)])
def test_a_coarse_spz_keeps_fewer_bits_of_harmonics(tmp_path, words, few):
    save_model(ExplicitModel(model=random_gaussians(50, degree=3)), tmp_path / "model", Origin())
    path = tmp_path / "m.spz"
    assert main(["export", str(tmp_path / "model"), "--spz", str(path), *words]) == 0
    stored = read_spz(path).sh[:, 4:] * 128 + 128
    kept = (stored % 16 == 0) | (stored == 255)
    assert bool(kept.all()) == few


@pytest.fixture
def on_the_tiny_scene(monkeypatch):
    scene = tiny_scene()
    monkeypatch.setattr(opening, "open_scene", lambda spec, protocol: scene)
    return scene


def scored(capsys, *arguments: str) -> dict:
    assert main(["score", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[0])


def test_a_file_is_scored_on_the_held_out_views_of_a_scene(written, on_the_tiny_scene, capsys):
    ply = str(written / "m.ply")
    assert main(["score", ply]) == 2
    assert "name it with --scene" in capsys.readouterr().err
    line = scored(capsys, ply, "--scene", "tiny", "--protocol", "3dgs")
    assert (line["scene"], line["image"]) == ("tiny", "0.png")
    # the truth of the tiny scene is drawn from the same Gaussians
    assert line["psnr"] > 40
    other = scored(capsys, str(written / "m.spz"), "--scene", "tiny", "--protocol", "3dgs")
    assert other["psnr"] != line["psnr"]


def test_a_file_in_the_original_frame_is_moved_into_the_scenes(on_the_tiny_scene, tmp_path, capsys):
    shift = torch.tensor([5e5, 4e6, 100.0], dtype=torch.float64)
    for name, moved in (("here", torch.zeros(3, dtype=torch.float64)), ("there", shift)):
        model = ExplicitModel(model=random_gaussians(40), shift=moved)
        save_model(model, tmp_path / name, Origin())
        assert main(["export", str(tmp_path / name), "--ply", str(tmp_path / f"{name}.ply")]) == 0
    more = ("--scene", "tiny", "--protocol", "3dgs")
    capsys.readouterr()
    here = scored(capsys, str(tmp_path / "here.ply"), *more)["psnr"]
    # the scene says no shift: Gaussians half a million units away are out of sight
    assert scored(capsys, str(tmp_path / "there.ply"), *more)["psnr"] < here - 5
    object.__setattr__(on_the_tiny_scene, "shift", shift + torch.tensor([0.25, 0.0, 0.0]))
    nudged = scored(capsys, str(tmp_path / "there.ply"), *more)["psnr"]
    object.__setattr__(on_the_tiny_scene, "shift", shift)
    assert nudged < scored(capsys, str(tmp_path / "there.ply"), *more)["psnr"] == here


def test_a_file_is_scored_against_images_of_a_file_of_cameras(written, tmp_path, capsys):
    view = camera_view(camera(0))
    truth = load_reconstruction(written / "model", backend="reference").render(view).colour
    (tmp_path / "truth").mkdir()
    image = np.floor(truth.clamp(0, 1).numpy() * 255 + 0.5)[..., ::-1]
    cv2.imwrite(str(tmp_path / "truth" / "0.png"), image)
    cameras = ("--cameras", str(written / "cameras.json"))
    line = scored(capsys, str(written / "m.ply"), str(tmp_path / "truth"), *cameras)
    assert line["psnr"] is None or line["psnr"] > 50  # null: not one byte differs
    for wrong in ((str(tmp_path / "truth"), str(tmp_path / "truth"), *cameras),
                  (str(written / "m.ply"), str(tmp_path / "truth"))):  # fmt: skip
        assert main(["score", *wrong]) == 2
        assert "give --cameras with a model alone" in capsys.readouterr().err


def rendered(folder: Path, model: ExplicitModel, pose: torch.Tensor) -> np.ndarray:
    """What `bench render` makes of a model from one camera of a file."""
    save_model(model, folder / "model", Origin())
    where = camera(0)
    entry = {"name": "0.png", "width": where.width, "height": where.height,
             "K": where.K.tolist(), "world_to_camera": pose.tolist()}  # fmt: skip
    (folder / "cameras.json").write_text(json.dumps([entry]))
    options = ["--cameras", str(folder / "cameras.json"), "--backend", "reference"]
    assert main(["render", str(folder / "model"), str(folder / "out"), *options]) == 0
    return picture(folder / "out" / "0.png")


@pytest.mark.parametrize("original", [True, False])
def test_a_shifted_model_is_seen_from_cameras_of_its_frame_and_of_the_original_one(
    original, tmp_path, capsys
):
    """Those of the original frame, as the scene's own model has them, saw nothing of it without a word."""
    shift = torch.tensor([512345.0, 4612345.0, 120.0], dtype=torch.float64)
    pose = camera(0).world_to_camera.clone()
    want = rendered(tmp_path, ExplicitModel(model=random_gaussians(40)), pose)
    capsys.readouterr()
    if original:
        pose[:3, 3] -= pose[:3, :3] @ shift
    got = rendered(tmp_path, ExplicitModel(model=random_gaussians(40), shift=shift), pose)
    assert np.abs(got - want).max() <= 1
    said = capsys.readouterr().err
    line = "cameras.json: cameras of the scene's original frame, moved by [-512345.0, -4612345.0, -120.0]"
    assert (line in said) is original


def test_a_small_model_is_seen_from_cameras_of_a_file(tmp_path):
    """As its scene's views see it: a flight in kilometres lies before the usual near plane."""
    unit, whole = 1e-3, random_gaussians(40)
    want = rendered(tmp_path, ExplicitModel(model=whole), camera(0).world_to_camera)
    small = replace(
        whole, means=unit * whole.means, log_scales=whole.log_scales + float(np.log(unit))
    )
    pose = camera(0).world_to_camera.clone()
    pose[:3, 3] *= unit
    assert np.abs(rendered(tmp_path, ExplicitModel(model=small), pose) - want).max() <= 1
    assert want.max() > 50


def test_files_that_cannot_be_used_are_named(written, tmp_path, capsys):
    for name, said in (
        ("gone.ply", "no such file"),
        ("gone.glb", "no such file"),
        ("gone.spz", "gone.spz"),
        ("gone.sog", "no such file"),
    ):
        assert main(["export", str(tmp_path / name), "--ply", str(tmp_path / "x.ply")]) == 2
        assert said in capsys.readouterr().err
    for option, name in (
        ("--gltf", "m.gltf"),
        ("--spz", "m.splat"),
        ("--sog", "m.zip"),
        ("--ply", "m"),
    ):
        assert main(["export", str(written / "model"), option, str(tmp_path / name)]) == 2
        assert "expected a name that ends in" in capsys.readouterr().err
    bad = tmp_path / "bad.ply"
    whole = (written / "m.ply").read_bytes()
    bad.write_bytes(whole.replace(b"element", b"comment splatproof mode antialiasee\nelement", 1))
    assert main(["export", str(bad), "--gltf", str(tmp_path / "x.glb")]) == 2
    assert "'antialiasee'" in capsys.readouterr().err


def test_a_foreign_file_says_nothing_of_where_it_comes_from(written):
    assert load_origin(written / "m.glb") == Origin()
    assert load_reconstruction(str(written / "m.glb")).primitives == 40
