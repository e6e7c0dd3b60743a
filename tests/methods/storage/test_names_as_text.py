"""Public functions take the name of a file as text where they take a path."""

import json
from dataclasses import replace

import pytest

from helpers import case_folders
from helpers.tiny_scene import camera, random_gaussians
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.gaussian_files import read_gaussians
from splatproof.methods.loading import load_origin, load_reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.camera_files import read_cameras
from splatproof.methods.storage.gltf import read_gltf, write_gltf
from splatproof.methods.storage.packed.reader import read_packed, unpack_packed
from splatproof.methods.storage.packed.writer import write_packed
from splatproof.methods.storage.ply import read_ply, write_ply
from splatproof.methods.storage.sog import read_sog, write_sog
from splatproof.methods.storage.spz import read_spz, write_spz
from splatproof.reports.store import find_cases
from splatproof.suites.records import read_record, write_record


@pytest.mark.parametrize(
    ("write", "read", "suffix"),
    [
        (write_ply, read_ply, ".ply"),
        (write_spz, read_spz, ".spz"),
        (write_sog, read_sog, ".sog"),
        (write_gltf, read_gltf, ".glb"),
        (write_packed, read_packed, ".spgs"),
    ],
)
def test_files_of_gaussians(write, read, suffix, tmp_path):
    name = f"{tmp_path}/m{suffix}"
    write(name, random_gaussians(3))
    read(name)
    assert len(read_gaussians(name)[0]) == 3


def test_folders_of_models_and_packed_files_of_them(tmp_path):
    save_model(ExplicitModel(model=random_gaussians(3)), f"{tmp_path}/model", Origin(method="m"))
    assert load_origin(f"{tmp_path}/model").method == "m"
    assert load_reconstruction(f"{tmp_path}/model").primitives == 3
    write_packed(f"{tmp_path}/m.spgs", random_gaussians(3))
    assert unpack_packed(f"{tmp_path}/m.spgs", f"{tmp_path}/unpacked") == 3


def test_cameras_and_records(tmp_path):
    where = camera(0)
    entry = {"name": "a", "width": where.width, "height": where.height, "K": where.K.tolist()}
    entry |= {"world_to_camera": where.world_to_camera.tolist()}
    (tmp_path / "c.json").write_text(json.dumps([entry]))
    assert list(read_cameras(f"{tmp_path}/c.json")) == ["a"]
    write_record(f"{tmp_path}/case", replace(case_folders.result(), seed=4))
    assert read_record(f"{tmp_path}/case").seed == 4
    assert find_cases(str(tmp_path)) == [tmp_path / "case"]
