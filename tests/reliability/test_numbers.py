"""Numbers that nothing can mean: on command lines, in TOML, JSON and models; each is one line."""

import json
import time

import numpy as np
import pytest
import torch

from helpers.adapter_checks import fixtures, protocol
from helpers.colmap_scenes import Flight, write_scene
from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError, UsageError
from splatproof.base.files import sha256
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.cli import main
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.colmap_index import ModelIndex, check_references
from splatproof.datasets.view_times import read_moments
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites import suite_files
from splatproof.suites.runner import select

NUMBERS = [
    (["fit", "3dgs", "x", "--out", "o", "--threads", "0"], "--threads"),
    (["fit", "3dgs", "x", "--out", "o", "--checkpoint-seconds", "nan"], "--checkpoint-seconds"),
    (["fit", "3dgs", "x", "--out", "o", "--checkpoint-seconds", "inf"], "--checkpoint-seconds"),
    (["fit", "3dgs", "x", "--out", "o", "--seed", str(2**70)], "--seed"),
    (["fit", "3dgs", "x", "--out", "o", "--seed", "-1"], "seed"),
    (["fit", "3dgs", "x", "--out", "o", "--dense-cell", "1e-9"], "dense_cell"),
    (["fit", "3dgs", "x", "--out", "o", "--dssim", "nan"], "dssim"),
    (["fit", "3dgs", "x", "--out", "o", "--rates.means", "inf"], "means"),
    (["fit", "stitchgs", "x", "--out", "o", "--workers", "0"], "--workers"),
    (["fit", "3dgs", "x", "--out", "o", "--width", "0"], "width"),
    (["export", "x", "--packed", "y", "--gate", "nan"], "--gate"),
    (["export", "x", "--packed", "y", "--gate", "-1"], "--gate"),
    (["export", "x", "--packed", "y", "--gate", "inf"], "--gate"),
    (["scenes", "make", "courtyard", "x", "--seed", str(2**70)], "--seed"),
    (["plan", "--memory-gb", "inf"], "--memory-gb"),
    (["plan", "--memory-gb", "nan"], "--memory-gb"),
    (["plan", "--views", "0"], "--views"),
    (["plan", "--margin", "1e300"], "--margin"),
    (["plan", "--machines", str(10**15)], "--machines"),
    (["plan", "--simulate", "--spread", "nan"], "--spread"),
    (["plan", "--simulate", "--spread", "1e9"], "--spread"),
    (["plan", "--simulate", "--seed", "-1"], "--seed"),
    (["plan", "--simulate", "--blocks", "1000000000"], "--simulate"),
]


@pytest.mark.parametrize(("arguments", "named"), NUMBERS, ids=lambda one: " ".join(one)[:60])
def test_a_number_out_of_range_is_named_in_one_line(
    arguments, named, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("bench: ")
    assert named in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seeds", [0, -1, 10_001, 10**9])
def test_more_seeds_than_anyone_runs(seeds, tmp_path):
    (tmp_path / "mine.toml").write_text(HEAD + CASES)
    with pytest.raises(UsageError, match=rf"--seeds is {seeds}, expected from 1 to 10000"):
        select(suite_files.load_suite(tmp_path / "mine.toml"), seeds=seeds)


def test_a_plan_for_more_machines_than_blocks_takes_no_memory(capsys):
    begun = time.process_time()
    assert main(["plan", "--machines", "1000000000", "--simulate", "--blocks", "8"]) == 0
    assert time.process_time() - begun < 5
    capsys.readouterr()


HEAD = 'description = "x"\n'
CASES = '[[cases]]\nscenes = ["courtyard"]\nmethods = ["3dgs"]\nprotocols = ["default"]\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + "cases = []", "cases: empty"),
        (HEAD + CASES + f"seeds = [{2**70}]", "seeds"),
        (HEAD + CASES + f"seeds = {list(range(10_001))}", "number of cases is 10001"),
        (HEAD + CASES + "[cases.settings.3dgs]\ndssim = nan", "dssim"),
        (HEAD + CASES + "[cases.settings.3dgs.rates]\nmeans = inf", "means"),
        (HEAD + CASES + f"[cases.settings.3dgs]\nsh_interval = {10**400}", "sh_interval"),
        (HEAD + "a = " + "[" * 20_000, "not a TOML file"),
    ],
    ids=lambda text: text[-30:],
)
def test_a_suite_with_such_numbers(text, said, tmp_path):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(UsageError, match=said) as caught:
        suite_files.load_suite(tmp_path / "mine.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rule", ["factor = nan", "factor = inf", "width = 99999999999999999999"])
def test_a_protocol_with_such_numbers(rule, tmp_path):
    (tmp_path / "mine.toml").write_text(f'source = "test"\n{rule}')
    with pytest.raises(UsageError, match=r"mine\.toml: .*(factor|width)"):
        load_protocol(tmp_path / "mine.toml")


@pytest.mark.parametrize("value", ["1e300", str(2**40), str(2**80), str(10**400), "NaN", "-Infinity",
                                   "1e999", "0", "-3", "true", '"96"', "null"])  # fmt: skip
@pytest.mark.parametrize("key", ["w", "fl_x", "k1"])
def test_a_camera_with_such_numbers(key, value, tmp_path):
    if key == "fl_x" and value in ("1e300", str(2**40), str(2**80)):
        pytest.skip("a long focal length is no fault of its own")
    if key == "k1" and value in ("0", "-3", "1e300", str(2**40), str(2**80)):
        pytest.skip("a number that distortion may have")
    fixtures("adapters").nerfstudio(tmp_path, views=1)
    path = tmp_path / "transforms.json"
    text = json.dumps(json.loads(path.read_text()) | {key: 12345.25})
    path.write_text(text.replace("12345.25", value))
    with pytest.raises(DataError, match=r"transforms\.json") as caught:
        open_scene(tmp_path, protocol())
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("value", ["1e999", "NaN", '"nan"', str(10**400), "null"])
def test_a_moment_with_such_numbers(value, tmp_path):
    (tmp_path / "views.json").write_text(f'{{"a": {{"time": {value}, "sensor": ""}}}}')
    with pytest.raises(DataError, match=r"views\.json"):
        read_moments(tmp_path, ["a"])


def test_a_double_id_among_many_is_found_at_once(tmp_path):
    ids = np.arange(300_000, dtype=np.uint64)
    ids[-1] = ids[-2]
    nothing = np.zeros(0, np.int64)
    index = ModelIndex(
        cameras=[1], image_ids=[], image_names=[], image_cameras=[], image_observations=[],
        point_ids=ids, positions=np.zeros((len(ids), 3)), colours=np.zeros((len(ids), 3), np.uint8),
        track_lengths=np.zeros(len(ids), np.int64), track_images=nothing,
        track_observations=nothing,
    )  # fmt: skip
    begun = time.process_time()
    with pytest.raises(DataError, match=r"points3D\.bin: id 299998 occurs more than once"):
        check_references(tmp_path, ".bin", index)
    assert time.process_time() - begun < 2  # a count for each id took 40 minutes


def test_a_text_model_that_is_cut_anywhere_is_refused(tmp_path):
    scene = write_scene(tmp_path / "scene", Flight(views=3, points=30), text=True)
    for name in ("points3D.txt", "images.txt", "cameras.txt"):
        path = scene / "sparse/0" / name
        whole = path.read_bytes()
        start = whole.index(b"# Number of") + 40 if name != "cameras.txt" else len(whole) - 20
        for size in np.linspace(start, len(whole) - 1, 15).astype(int):
            path.write_bytes(whole[:size])
            with pytest.raises(DataError):
                open_scene(scene, protocol(hold=2))
        path.write_bytes(whole)
    open_scene(scene, protocol(hold=2))


@pytest.fixture
def model(tmp_path):
    folder = tmp_path / "model"
    save_model(ExplicitModel(model=random_gaussians(5), backend="reference"), folder, Origin())
    return folder


def with_arrays(folder, **changed):
    """Other arrays under their right hash."""
    tensors, _ = read_tensors(folder / "model.safetensors")
    write_tensors(folder / "model.safetensors", tensors | changed)
    told = json.loads((folder / "model.json").read_text())
    told["arrays_sha256"] = sha256(folder / "model.safetensors")
    (folder / "model.json").write_text(json.dumps(told))


ARRAYS = [
    {"means": torch.zeros(5, 3, dtype=torch.float64)},
    {"means": torch.zeros(5, 3, dtype=torch.int64)},
    {"means": torch.zeros(5, 3, dtype=torch.bool)},
    {"means": torch.zeros(5, 3, dtype=torch.float16)},
    {"means": torch.tensor(1.0)},
    {"sh": torch.zeros(5)},
    {"sh": torch.zeros(5, 3)},
    {"opacity_logits": torch.zeros(5, 1)},
    {"quaternions": torch.full((5, 4), torch.nan)},
    {"means": torch.zeros(0, 3), "quaternions": torch.zeros(0, 4), "log_scales": torch.zeros(0, 3),
     "opacity_logits": torch.zeros(0), "sh": torch.zeros(0, 4, 3)},
]  # fmt: skip


@pytest.mark.parametrize("changed", ARRAYS, ids=str)
def test_arrays_of_other_types_and_shapes_under_right_hashes(model, changed):
    with_arrays(model, **changed)
    with pytest.raises(DataError, match=r"model\.safetensors: ") as caught:
        load_reconstruction(model)
    assert "\n" not in str(caught.value)


FACTS = [
    {"shift": [None, 0, 0]}, {"shift": "abc"}, {"shift": {}}, {"shift": [1e308 * 10, 0, 0]},
    {"shift": 3}, {"shift": [0, 0]}, {"shift": [10**400, 0, 0]}, {"mode": []}, {"mode": 3},
    {"kind": []}, {"kind": {}}, {"kind": "city"}, {"origin": []}, {"version": {}}, {"format": []},
]  # fmt: skip


@pytest.mark.parametrize("changed", FACTS, ids=lambda one: str(one)[:40])
def test_descriptions_of_other_shapes(model, changed):
    path = model / "model.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))
    if "origin" in changed:
        assert main(["render", str(model), str(model / "out")]) == 2
        return
    with pytest.raises(DataError, match=r"model\.json|regions") as caught:
        load_reconstruction(model)
    assert "\n" not in str(caught.value)
