"""The .glb writer and reader: what comes back is what went in, to float32's last digits."""

import json
import struct

import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError
from splatproof.base.memory import peak_memory_mb
from splatproof.methods.storage.gltf import EXTENSION, read_gltf, write_gltf

EPS = torch.finfo(torch.float32).eps


@settings(max_examples=15)
@given(count=st.integers(1, 60), degree=st.integers(0, 3), seed=st.integers(0, 2**16))
def test_what_comes_back_is_what_went_in(tmp_path_factory, count, degree, seed):
    path = tmp_path_factory.mktemp("glb") / "m.glb"
    whole = random_gaussians(count, degree=degree, seed=seed)
    shift = torch.tensor([4e5, 5e6, 0.1], dtype=torch.float64)
    write_gltf(path, whole, shift, "antialiased")
    back, moved, mode = read_gltf(path)
    assert torch.equal(moved, shift)
    assert mode == "antialiased"
    assert torch.equal(back.means, whole.means)
    assert torch.equal(back.sh, whole.sh)
    # exp rounds relative to the scale, so its logarithm is off by that and its own rounding
    assert (back.log_scales - whole.log_scales).abs().max() <= 2 * EPS + 4 * EPS
    assert (back.opacities - whole.opacities).abs().max() <= 2 * EPS
    assert (back.quaternions - whole.unit_quaternions).abs().max() <= 2 * EPS


def document_of(path) -> tuple[dict, bytes]:
    content = path.read_bytes()
    (size,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + size]), content[20 + size + 8 :]


def rewritten(path, document: dict, body: bytes) -> None:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    parts = (
        struct.pack("<I4s", len(text), b"JSON"),
        text,
        struct.pack("<I4s", len(body), b"BIN\0"),
    )
    path.write_bytes(head + b"".join(parts) + body)


def test_the_file_says_what_the_extension_asks_for(tmp_path):
    whole = random_gaussians(5, degree=1)
    write_gltf(tmp_path / "m.glb", whole)
    document, body = document_of(tmp_path / "m.glb")
    assert document["extensionsUsed"] == [EXTENSION]
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"][EXTENSION]["kernel"] == "ellipse"
    assert primitive["extensions"][EXTENSION]["colorSpace"] == "srgb_rec709_display"
    names = [name.removeprefix(f"{EXTENSION}:") for name in primitive["attributes"]]
    harmonics = ["SH_DEGREE_0_COEF_0", *(f"SH_DEGREE_1_COEF_{n}" for n in range(3))]
    assert names == ["POSITION", "ROTATION", "SCALE", "OPACITY", *harmonics]

    def stored(name):
        accessor = document["accessors"][primitive["attributes"][f"{EXTENSION}:{name}"]]
        view = document["bufferViews"][accessor["bufferView"]]
        start = view["byteOffset"]
        return torch.frombuffer(
            bytearray(body[start : start + view["byteLength"]]), dtype=torch.float32
        )

    # activated, and the real part of a quaternion last
    assert torch.allclose(stored("SCALE").reshape(-1, 3), whole.scales)
    assert torch.allclose(stored("OPACITY"), whole.opacities)
    assert torch.allclose(stored("ROTATION").reshape(-1, 4)[:, 3], whole.unit_quaternions[:, 0])


def test_another_reader_finds_the_points_where_they_are(tmp_path):
    whole = random_gaussians(7)
    write_gltf(tmp_path / "m.glb", whole)
    (cloud,) = trimesh.load_scene(tmp_path / "m.glb").geometry.values()
    assert torch.equal(torch.from_numpy(cloud.vertices).float(), whole.means)


def test_opacities_and_scales_at_their_ends_stay_finite(tmp_path):
    whole = random_gaussians(2)
    whole.opacity_logits[:] = torch.tensor([80.0, -80.0])
    whole.log_scales[0] = -200.0
    write_gltf(tmp_path / "m.glb", whole)
    back, _, _ = read_gltf(tmp_path / "m.glb")
    assert (back.opacities - whole.opacities).abs().max() <= EPS
    assert back.log_scales[0, 0] < -80


def test_what_is_no_file_of_gaussians_is_refused_by_name(tmp_path):
    path = tmp_path / "m.glb"
    with pytest.raises(DataError, match=r"m\.glb: no such file"):
        read_gltf(path)
    write_gltf(path, random_gaussians(4))
    content = path.read_bytes()
    for faulty in (content[:-4], b"ply\n" + content[4:], content[:12] + b"\xff" * 8):
        path.write_bytes(faulty)
        with pytest.raises(DataError, match=r"m\.glb: not a whole"):
            read_gltf(path)
    with path.open("r+b") as file:  # as sparse a file as a disk has
        file.truncate(8 * 2**30)
    before = peak_memory_mb()
    with pytest.raises(DataError, match=r"m\.glb: not a whole"):
        read_gltf(path)
    assert peak_memory_mb() - before < 100
    path.write_bytes(content)
    document, body = document_of(path)
    primitive = document["meshes"][0]["primitives"][0]
    faults = [
        (lambda: primitive["attributes"].pop(f"{EXTENSION}:SCALE"), "not a whole"),
        (lambda: primitive["extensions"].clear(), "0 primitives with"),
        (lambda: document["nodes"][0].update(rotation=[0, 0, 1, 0]), "a node moves"),
        (lambda: document["nodes"][0]["extras"]["splatproof"].update(mode="odd"), "mode 'odd'"),
        (lambda: document["accessors"][2].update(componentType=5123), "packed float32"),
    ]
    for spoil, said in faults:
        document, _ = document_of(path)
        primitive = document["meshes"][0]["primitives"][0]
        spoil()
        rewritten(tmp_path / "bad.glb", document, body)
        with pytest.raises(DataError, match=said):
            read_gltf(tmp_path / "bad.glb")
