"""`bench fit`, `bench render` and `bench export`, from arguments to files."""

import json
import shutil
from dataclasses import asdict
from functools import partial

import cv2
import numpy as np
import pytest
from plyfile import PlyData

from helpers.tiny_scene import camera, tiny_scene
from splatproof.cli import main, report
from splatproof.datasets.catalogue import opening
from splatproof.methods.loading import load_origin, load_reconstruction
from splatproof.metrics.parts import is_part_key
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import camera_view
from splatproof.suites import run_case as cases
from splatproof.suites import runner, scenes
from splatproof.suites.records import read_record
from splatproof.suites.workers import in_process

OPTIONS = ["--backend", "reference", "--protocol", "3dgs", "--seed", "4"]
SETTINGS = ["--iterations", "4", "--density.most", "50"]


def bench_fit(out, *more: str) -> int:
    """`bench fit` on a tiny scene, in this process and without a tracking store."""
    scene = out.parent / "tiny"
    scene.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for module in (cases, scenes):
            patch.setattr(module, "open_scene", lambda spec, protocol: tiny_scene())
        patch.setattr(runner, "run_alone", partial(runner.run_alone, launch=in_process))
        patch.setattr(report, "sync_cases", lambda out, uri: False)
        return main(["fit", "3dgs", str(scene), "--out", str(out), *OPTIONS, *SETTINGS, *more])


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A model folder made by `bench fit` on a tiny scene."""
    out = tmp_path_factory.mktemp("fit") / "out"
    assert bench_fit(out) == 0
    return out


def test_fit_leaves_a_model_with_its_settings(fitted):
    facts = json.loads((fitted / "model" / "model.json").read_text())
    origin = facts["origin"]
    assert (origin["method"], origin["variant"], origin["seed"]) == ("3dgs", "", 4)
    assert (origin["settings"]["iterations"], origin["settings"]["density"]["most"]) == (4, 50)
    assert origin["scene"] == str(fitted.parent / "tiny")
    assert origin["protocol"] == json.loads(json.dumps(asdict(load_protocol("3dgs"))))
    assert (fitted / "renders" / "0.png").exists()


def test_fit_leaves_the_record_of_a_suite_of_one_case(fitted):
    result = read_record(fitted)
    assert (result.suite, result.suite_scenes, result.scene) == ("fit", (), "tiny")
    assert (result.method, result.variant, result.seed, result.protocol) == ("3dgs", "", 4, "3dgs")
    assert set(result.stages) == {"load", "init", "train", "save", "score"}
    assert result.curve[-1][0] == 4
    assert result.environment["backend"] == "reference"
    assert not list(fitted.rglob("*.partial"))
    assert not (fitted / "checkpoint").exists()


def test_fit_prints_scores_and_a_finished_run_is_not_trained_again(fitted, capsys):
    before = (fitted / "record.json").stat().st_mtime_ns
    assert bench_fit(fitted, "--json") == 0
    assert (fitted / "record.json").stat().st_mtime_ns == before
    image, whole = map(json.loads, capsys.readouterr().out.splitlines())
    assert image["image"] == "0.png"
    label = {"scene": "tiny", "method": "3dgs", "seed": 4, "protocol": "3dgs"}
    assert label.items() <= image.items()
    assert (label | {"suite": "fit", "status": "kept", "error": ""}).items() <= whole.items()
    assert whole["psnr"] == image["psnr"] > 5
    assert bench_fit(fitted, "--quiet") == 0
    shown = capsys.readouterr()
    assert [line.split()[0] for line in shown.out.splitlines()] == ["0.png", "mean"]
    assert shown.err == ""


def test_render_from_a_camera_file(fitted, tmp_path, capsys):
    where = camera(0)
    cameras = [
        {"name": "sub/left.jpg", "width": where.width, "height": where.height,
         "K": where.K.tolist(), "world_to_camera": where.world_to_camera.tolist()}
    ]  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    arguments = [str(fitted), str(tmp_path / "out"), "--cameras", str(tmp_path / "cameras.json")]
    for more in (["--scene", "tiny"], ["--views", "all"]):
        assert main(["render", *arguments, *more]) == 2
        assert "--cameras says what is rendered" in capsys.readouterr().err
    assert main(["render", *arguments, "--backend", "reference"]) == 0
    got = cv2.imread(str(tmp_path / "out" / "sub-left.png"))
    want = (
        load_reconstruction(fitted / "model", backend="reference").render(camera_view(where)).colour
    )
    want = np.floor(want.clamp(0, 1).numpy() * 255 + 0.5)[..., ::-1]
    assert got is not None
    assert np.array_equal(got, want)


def test_the_pictures_of_a_fit_are_scored_under_its_own_protocol(fitted, tmp_path, capsys):
    arguments = ["score", str(fitted / "renders"), str(fitted / "truth"), "--json"]
    image = read_record(fitted).images[0]

    def scored(*more: str) -> dict:
        assert main([*arguments, *more]) == 0
        return json.loads(capsys.readouterr().out.splitlines()[0])

    own = scored()
    assert own["protocol"] == "3dgs"
    whole = {name: value for name, value in image.metrics.items() if not is_part_key(name)}
    assert {name: own[name] for name in whole} == whole
    assert scored("--protocol", "default")["protocol"] == "default"
    arguments[2] = str(tmp_path / "truth")
    shutil.copytree(fitted / "truth", arguments[2])
    assert scored()["protocol"] == "default"


def test_masks_of_a_case_belong_to_its_own_protocol(fitted, tmp_path, capsys):
    case = tmp_path / "case"
    shutil.copytree(fitted, case)
    shutil.copytree(case / "truth", case / "masks")
    mask = cv2.imread(str(case / "masks" / "0.png"))
    assert mask is not None
    mask[:] = 255
    mask[:, ::2] = 0
    cv2.imwrite(str(case / "masks" / "0.png"), mask)
    record = (case / "record.json").read_text()
    (case / "record.json").write_text(record.replace('"masked": false', '"masked": true'))
    for more, share in (([], 0.5), (["--protocol", "default"], 1.0)):
        pictures = [str(case / "renders"), str(case / "truth")]
        assert main(["score", *pictures, "--json", *more]) == 0
        assert json.loads(capsys.readouterr().out.splitlines()[0])["valid_share"] == share


@pytest.fixture
def asked(monkeypatch):
    """What `bench render` opens: (scene, protocol); it finds the tiny scene each time."""
    seen = []

    def opened(spec, protocol):
        seen.append((spec, protocol))
        return tiny_scene()

    monkeypatch.setattr(opening, "open_scene", opened)
    return seen


def test_a_model_renders_its_own_scored_views_byte_for_byte(fitted, tmp_path, asked):
    assert main(["render", str(fitted), str(tmp_path), "--backend", "reference"]) == 0
    assert asked == [(str(fitted.parent / "tiny"), load_protocol("3dgs"))]
    assert [path.name for path in tmp_path.iterdir()] == ["0.png"]
    assert (tmp_path / "0.png").read_bytes() == (fitted / "renders" / "0.png").read_bytes()


def test_a_scene_and_a_protocol_that_are_named_go_first(fitted, tmp_path, asked, capsys):
    (tmp_path / "white.toml").write_text('source = "ours"\nbackground = [1.0, 1.0, 1.0]\n')
    options = ["--scene", "elsewhere", "--protocol", str(tmp_path / "white.toml"), "--json"]
    out = tmp_path / "out"
    assert main(["render", str(fitted), str(out), *options, "--views", "all"]) == 0
    ((scene, protocol),) = asked
    assert (scene, protocol.name, protocol.background) == ("elsewhere", "white", (1.0, 1.0, 1.0))
    assert len(list(out.iterdir())) == 6
    assert (out / "0.png").read_bytes() != (fitted / "renders" / "0.png").read_bytes()
    told = json.loads(capsys.readouterr().out)
    assert told == {"out": str(out), "images": 6, "source": "elsewhere", "protocol": "white"}


def test_what_a_model_does_not_know_is_asked_for_in_one_line(fitted, tmp_path, asked, capsys):
    moved = tmp_path / "moved"
    shutil.copytree(fitted / "model", moved)
    told = json.loads((moved / "model.json").read_text())
    whole = told["origin"]

    def refused(*more: str, **changes: object) -> str:
        told["origin"] = whole | changes
        (moved / "model.json").write_text(json.dumps(told))
        assert main(["render", str(moved), str(tmp_path / "out"), *more]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return line

    assert "does not say which scene" in refused(scene="")
    assert "which is no folder any more; say with --scene" in refused(scene="/gone/away")
    assert "does not say which protocol" in refused(protocol={})
    assert "name a protocol with --protocol" in refused(protocol={"name": "x", "hodl": 1})
    assert "does not say which protocol" in refused("--scene", "tiny", scene="", protocol={})
    assert not asked
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("inside", ["", "model"])
def test_export(fitted, tmp_path, capsys, inside):
    assert main(["export", str(fitted / inside), "--ply", str(tmp_path / "a.ply"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["gaussians"] == PlyData.read(tmp_path / "a.ply")["vertex"].count
    assert said["frame"] == "as trained"


def test_packed_files_of_every_quality_and_of_the_version_before(fitted, tmp_path, capsys):
    sizes = {}
    for words in ("--quality=fine", "", "--quality=coarse", "--profile=fast", "--gate=0.02"):
        path = tmp_path / f"{words}.spgs"
        options = [words] if words else []
        assert main(["export", str(fitted / "model"), "--packed", str(path), *options]) == 0
        sizes[words] = path.stat().st_size
        assert main(["export", str(path), "--ply", str(tmp_path / "m.ply")]) == 0
    assert sizes["--quality=coarse"] < sizes[""] < sizes["--quality=fine"] < sizes["--gate=0.02"]
    assert sizes[""] != sizes["--profile=fast"]
    versions = {words: (tmp_path / f"{words}.spgs").read_bytes()[4] for words in sizes}
    assert versions == {words: 2 if "gate" in words else 3 for words in sizes}


def test_fewer_gaussians_and_tuned_ones(fitted, tmp_path, capsys, asked):
    def exported(name: str, *options: str) -> dict:
        where = ["--packed", str(tmp_path / name), "--json"]
        assert main(["export", str(fitted), *where, *options]) == 0
        return json.loads(capsys.readouterr().out)

    whole, few = exported("a"), exported("b", "--thin", "0.25")
    assert few["gaussians"] == whole["gaussians"] - round(0.25 * whole["gaussians"])
    both = exported("c", "--thin", "0.25", "--tune", "40")
    assert both["gaussians"] == few["gaussians"]
    assert (tmp_path / "c").read_bytes() != (tmp_path / "b").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "c"]  # no checkpoint
    assert asked == 2 * [(str(fitted.parent / "tiny"), load_protocol("3dgs"))]
    assert load_origin(tmp_path / "c") == load_origin(fitted / "model")


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--thin", "1.5"], "--thin is 1.5"), (["--tune", "0"], "--tune is 0"),
     (["--tune", "9", "--gate", "0"], "has no --tune")],
)  # fmt: skip
def test_what_cannot_be_made_smaller_is_refused(fitted, tmp_path, capsys, words, said):
    assert main(["export", str(fitted), "--packed", str(tmp_path / "m"), *words]) == 2
    assert said in capsys.readouterr().err
    assert main(["export", str(fitted), "--ply", str(tmp_path / "m.ply"), "--tune", "5"]) == 2
    assert "--tune is for --packed FILE" in capsys.readouterr().err


def test_a_packed_export_renders_and_exports_again(fitted, tmp_path, capsys, asked):
    packed, ply = tmp_path / "m.spgs", tmp_path / "m.ply"
    assert main(["export", str(fitted / "model"), "--packed", str(packed), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["bytes"] == packed.stat().st_size == sum(told["bytes_by_part"].values())
    assert main(["export", str(packed), "--ply", str(ply)]) == 0
    assert len(PlyData.read(ply)["vertex"].data) == told["gaussians"]
    out = tmp_path / "renders"
    assert main(["render", str(packed), str(out)]) == 0
    assert asked == [(str(fitted.parent / "tiny"), load_protocol("3dgs"))]
    assert load_origin(packed) == load_origin(fitted / "model")
    mine, whole = (cv2.imread(str(f / "0.png")) for f in (out, fitted / "renders"))
    assert np.abs(np.asarray(mine, dtype=int) - np.asarray(whole, dtype=int)).max() <= 2
    capsys.readouterr()
    packed.write_bytes(packed.read_bytes()[:-1])
    assert main(["render", str(packed), str(out), "--scene", "tiny", "--protocol", "3dgs"]) == 2
    assert "m.spgs" in capsys.readouterr().err
    assert main(["export", str(fitted / "model")]) == 2
    assert "--packed" in capsys.readouterr().err
    before = sorted(tmp_path.rglob("*"))
    assert main(["export", str(fitted), "--ply", str(tmp_path / "b.ply"), "--gate", "0"]) == 2
    assert "--gate is for --packed" in capsys.readouterr().err
    for name in ("--quality=fine", "--profile=fast"):
        assert main(["export", str(fitted), "--ply", str(tmp_path / "b.ply"), name]) == 2
        assert f"{name.partition('=')[0]} is for --packed FILE" in capsys.readouterr().err
        both = ["--packed", str(tmp_path / "b.spgs"), "--gate", "0.02", name]
        assert main(["export", str(fitted), *both]) == 2
        assert "leave one out" in capsys.readouterr().err
    assert main(["export", str(fitted), "--packed", str(tmp_path / "b.spgs"), "--local"]) == 2
    assert "--local is for --ply" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["export", "nowhere", "--ply", "a.ply"], 2, "model.json: no such file"),
        (["render", "nowhere", "out"], 2, "model.json: no such file"),
        (["fit", "3dgs", "x", "--out", "o", "--iterations", "0"], 2, "iterations is 0, expected"),
        (["fit", "3dgs", "x", "--out", "o", "--backend", "gpu"], 2, "did you mean"),
        (["fit", "3dgs", "x", "--out", "o", "--density.strat", "1"], 2, "--density.start"),
        (["fit", "3gds", "x", "--out", "o"], 2, "3dgs"),
    ],
)
def test_bad_arguments_are_told_and_leave_nothing(
    arguments, code, said, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == code
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
