"""The .glb writer and reader: what comes back is what went in, to float32's last digits."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError
from splatproof.base.memory import peak_memory_mb
from splatproof.methods.storage.gltf import EXTENSION, read_gltf, write_gltf
from splatproof.reference.types.gaussians import Gaussians

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
        (
            lambda: document["accessors"][0].update(componentType=5123),
            "POSITION has components of type 5123",
        ),
        (
            lambda: document["accessors"][2].update(componentType=5122, normalized=True),
            "SCALE has normalised components of type 5122",
        ),
        (
            lambda: document["accessors"][3].update(componentType=5121),
            "OPACITY has components of type 5121",
        ),
        (
            lambda: document["accessors"][1].update(componentType=9),
            "ROTATION has components of type 9",
        ),
        (lambda: document["accessors"][0].update(sparse={}), "accessor 0 is sparse"),
        (lambda: document["bufferViews"][0].update(byteStride=8), "accessor 0 has 8 bytes"),
        (lambda: document["bufferViews"][0].update(byteStride=252), "not a whole"),
        (lambda: document["bufferViews"][0].update(byteOffset=-4), "not a whole"),
        (lambda: document["accessors"][0].update(count=10**12), "not a whole"),
        (
            lambda: document["nodes"].append({"children": [0], "translation": [0, 0, 1]}),
            "a node moves",
        ),
        (lambda: document["nodes"][0].update(scale=[1, 1, 2]), "a node moves"),
        (lambda: document["nodes"][0].update(matrix=[1.0] * 16), "a node moves"),
        (
            lambda: primitive["extensions"][EXTENSION].update(colorSpace="lin_rec709_display"),
            r"colorSpace of its Gaussians is 'lin_rec709_display', expected 'srgb_rec709_display'",
        ),
        (
            lambda: primitive["extensions"][EXTENSION].pop("colorSpace"),
            "colorSpace of its Gaussians is None",
        ),
        (
            lambda: primitive["extensions"][EXTENSION].update(kernel="box"),
            "kernel of its Gaussians is 'box'",
        ),
    ]
    for spoil, said in faults:
        document, _ = document_of(path)
        primitive = document["meshes"][0]["primitives"][0]
        spoil()
        rewritten(tmp_path / "bad.glb", document, body)
        with pytest.raises(DataError, match=said) as caught:
            read_gltf(tmp_path / "bad.glb")
        assert str(caught.value).startswith(f"{tmp_path / 'bad.glb'}: ")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [("SCALE", -0.25, "SCALE of -0.25, expected 0 or more"), ("OPACITY", 1 + 1e-6, "OPACITY of 1.00000095, expected"),
     ("OPACITY", -1.0, "OPACITY of -1, expected 0 to 1"), ("OPACITY", torch.nan, "opacity_logits of Gaussian 2")],
)  # fmt: skip
def test_scales_and_opacities_that_are_none_are_refused(tmp_path, name, value, said):
    path = tmp_path / "m.glb"
    write_gltf(path, random_gaussians(4))
    document, body = document_of(path)
    at = document["meshes"][0]["primitives"][0]["attributes"][f"{EXTENSION}:{name}"]
    size = 4 * {"SCALAR": 1, "VEC3": 3}[document["accessors"][at]["type"]]
    start = document["bufferViews"][at]["byteOffset"] + 2 * size
    rewritten(path, document, body[:start] + struct.pack("<f", value) + body[start + 4 :])
    with pytest.raises(DataError, match=said):
        read_gltf(path)


def test_a_draft_with_logarithms_of_scales_is_refused(tmp_path):
    whole = random_gaussians(4)
    write_gltf(tmp_path / "m.glb", replace(whole, log_scales=whole.log_scales.exp()))
    read_gltf(tmp_path / "m.glb")
    document, body = document_of(tmp_path / "m.glb")
    at = document["bufferViews"][2]["byteOffset"]
    scales = whole.log_scales.numpy().tobytes()
    rewritten(tmp_path / "m.glb", document, body[:at] + scales + body[at + len(scales) :])
    with pytest.raises(DataError, match=r"SCALE of -.*draft of the extension had logarithms"):
        read_gltf(tmp_path / "m.glb")


def test_a_model_of_no_gaussians_is_refused_and_leaves_nothing(tmp_path):
    nothing = Gaussians(**{name: values[:0] for name, values in vars(random_gaussians(1)).items()})
    with pytest.raises(DataError, match=r"m\.glb: 0 Gaussians\. Expected at least one"):
        write_gltf(tmp_path / "m.glb", nothing)
    assert not list(tmp_path.iterdir())


def test_nodes_that_move_nothing_are_read_over(tmp_path):
    path, whole = tmp_path / "m.glb", random_gaussians(4)
    write_gltf(path, whole)
    document, body = document_of(path)
    identity = [float(i % 5 == 0) for i in range(16)]
    document["nodes"][0].update(scale=[1, 1, 1], rotation=[0, 0, 0, 1.0], translation=[0.0, 0, 0])
    document["nodes"] += [{"children": [0], "matrix": identity}, {"children": [1]}]
    document["nodes"] += [{"children": [4], "translation": [1, 2, 3]}, {}]  # beside it
    rewritten(path, document, body)
    assert torch.equal(read_gltf(path)[0].means, whole.means)
    document["nodes"][0]["children"] = [2]  # in a ring, as no tree is
    rewritten(path, document, body)
    assert torch.equal(read_gltf(path)[0].means, whole.means)


@pytest.mark.parametrize(
    ("rotation", "scale", "opacity"),
    [(("i1", True), ("u1", True), ("u1", True)), (("i2", True), ("u2", True), ("u2", True)),
     (("i2", True), ("u1", False), ("u1", True)), (("i1", True), ("u2", False), ("u2", True))],
)  # fmt: skip
@pytest.mark.parametrize("apart", [0, 8])
def test_every_type_of_number_that_the_extension_allows_is_read(
    tmp_path, rotation, scale, opacity, apart
):
    path, whole = tmp_path / "m.glb", random_gaussians(9)
    write_gltf(path, whole)
    document, body = document_of(path)
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    numbers = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123}
    wanted = {"ROTATION": whole.unit_quaternions.roll(-1, dims=1), "SCALE": whole.scales,
              "OPACITY": whole.opacities[:, None]}  # fmt: skip
    wanted["ROTATION"][3] = torch.tensor([-1.0, 0, 0, 0])
    stored = {}
    for name, (kind, normalised) in zip(wanted, (rotation, scale, opacity), strict=True):
        most = np.iinfo(kind).max if normalised else 1
        values = wanted[name].double().numpy() * (1 if normalised else 100)
        whole_numbers = np.rint(values * most).astype(f"<{kind}")
        if name == "ROTATION":
            whole_numbers[3, 0] = np.iinfo(kind).min  # two integers stand for -1
        stored[name] = (whole_numbers / most).clip(-1 if normalised else 0)
        size = whole_numbers.dtype.itemsize * whole_numbers.shape[1]
        stride = -(-size // 4) * 4 + apart  # vertices begin at multiples of four
        rows = np.zeros((9, stride), np.uint8)
        rows[:, :size] = whole_numbers.view(np.uint8).reshape(9, size)
        place = attributes[f"{EXTENSION}:{name}"]
        document["accessors"][place] |= {"componentType": numbers[kind], "normalized": normalised}
        document["bufferViews"][place] |= {"byteOffset": len(body), "byteStride": stride}
        body += rows.tobytes()
    rewritten(path, document, body)
    back, _, _ = read_gltf(path)
    assert np.abs(back.quaternions.roll(-1, dims=1).numpy() - stored["ROTATION"]).max() <= EPS
    found = back.scales.double().numpy()
    # a logarithm of up to log 65535 is rounded, and so is its power
    assert (np.abs(found - stored["SCALE"].clip(1e-37)) <= 16 * EPS * stored["SCALE"] + 1e-37).all()
    assert np.abs(back.opacities[:, None].numpy() - stored["OPACITY"]).max() <= 4 * EPS
    assert torch.equal(back.sh, whole.sh)
