""".ply files: the release's names and order, exact round trip, foreign and broken files."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement

from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.storage.ply import properties, read_ply, write_ply


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("ply")


def release_layout(gaussians) -> np.ndarray:
    """The file's body as the release's save_ply lays it out: rows of float32."""
    sh = gaussians.sh
    higher = sh[:, 1:].transpose(1, 2).reshape(len(sh), -1)
    return torch.cat(
        [gaussians.means, torch.zeros(len(sh), 3), sh[:, 0], higher,
         gaussians.opacity_logits[:, None], gaussians.log_scales, gaussians.quaternions], dim=1
    ).numpy()  # fmt: skip


@given(count=st.integers(1, 20), degree=st.integers(0, 3), seed=st.integers(0, 99))
def test_bytes_are_the_release_layout_and_the_round_trip_is_exact(folder, count, degree, seed):
    model, path = random_gaussians(count, degree=degree, seed=seed), folder / "a.ply"
    write_ply(path, model)
    header, body = path.read_bytes().split(b"end_header\n", 1)
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\nelement vertex %d\n" % count)
    names = [line.split()[2].decode() for line in header.splitlines() if b"property float" in line]
    assert names == properties((degree + 1) ** 2)
    assert body == release_layout(model).astype("<f4").tobytes()
    back, shift = read_ply(path)
    assert not shift.any()
    for name in FIELDS:
        assert torch.equal(getattr(back, name), getattr(model, name))


def test_properties_of_degree_3():
    names = properties(16)
    assert names[:10] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0"]
    assert names[53:] == [
        "f_rest_44", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ]  # fmt: skip


def test_shift_is_added_in_float64_and_taken_off_again(folder):
    model, path = random_gaussians(9), folder / "utm.ply"
    shift = torch.tensor([500_000.25, 4_200_000.5, 300.125], dtype=torch.float64)
    write_ply(path, model, shift)
    vertex = PlyData.read(path)["vertex"]
    for axis, name in enumerate("xyz"):
        want = model.means[:, axis].double() + shift[axis]
        assert np.array_equal(vertex[name], want.numpy())
    back, said = read_ply(path)
    assert torch.equal(said, shift)
    # the file's float64 resolves 1e-9 at 4e6
    torch.testing.assert_close(back.means, model.means, atol=1e-9, rtol=1e-7)


def foreign(folder, *, text=False, order="<", drop=(), extra=(), change=None, kind="f4"):
    """A file of another tool: any byte order, without normals, shuffled properties."""
    model = random_gaussians(5)
    names = [n for n in properties(4) if not n.startswith("n") and n not in drop]
    rows = np.zeros(5, dtype=[(n, kind) for n in [*reversed(names), *extra]])
    columns = dict(zip(properties(4), release_layout(model).T, strict=True))
    for name in names:
        rows[name] = columns[name]
    if change:
        change(rows)
    path = folder / "foreign.ply"
    PlyData([PlyElement.describe(rows, "vertex")], text=text, byte_order=order).write(path)
    return path, model


@pytest.mark.parametrize("form", [{}, {"text": True}, {"order": ">"}, {"kind": "f8"}])
def test_other_tools_files_are_read(folder, form):
    path, model = foreign(folder, extra=("red",), **form)
    back, _ = read_ply(path)
    for name in FIELDS:
        torch.testing.assert_close(getattr(back, name), getattr(model, name), rtol=1e-6, atol=1e-6)


def test_far_positions_are_centred_before_they_become_float32(folder):
    def far(rows):
        rows["y"] += 4e6

    path, model = foreign(folder, kind="f8", change=far)
    back, shift = read_ply(path)
    assert shift[1] == pytest.approx(4e6, abs=1)
    got = back.means.double() + shift - torch.tensor([0, 4e6, 0], dtype=torch.float64)
    torch.testing.assert_close(got.float(), model.means, atol=1e-6, rtol=0)


def put_nan(rows):
    rows["scale_1"][3] = np.nan


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ({"drop": ("rot_3",)}, "no property 'rot_3'"),
        ({"drop": ("f_rest_4",)}, "8 f_rest properties, expected 0, 9, 24 or 45"),
        ({"change": put_nan}, "scale_1 of vertex 3 is nan"),
    ],
)
def test_unfit_files_are_refused(folder, form, said):
    path, _ = foreign(folder, **form)
    with pytest.raises(DataError, match=said) as error:
        read_ply(path)
    assert "\n" not in str(error.value)


def spoil(content: bytes, how: str) -> bytes:
    return {
        "cut": content[:-3],
        "short header": content[:40],
        "huge count": content.replace(b"vertex 5", b"vertex 999999999999"),
        "more than there is": content.replace(b"vertex 5", b"vertex 6"),
        "not a ply": b"\x89PNG" + content,
        "other element": content.replace(b"element vertex", b"element points"),
        "no vertices": content.replace(b"vertex 5", b"vertex 0"),
        "empty": b"",
    }[how]


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(
    "how", ["cut", "short header", "huge count", "more than there is", "not a ply",
            "other element", "no vertices", "empty"]
)  # fmt: skip
def test_broken_files_are_refused_in_one_line(folder, how, text):
    path, _ = foreign(folder, text=text)
    path.write_bytes(spoil(path.read_bytes(), how))
    if how == "cut" and text:
        path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(DataError, match="foreign.ply: ") as error:
        read_ply(path)
    assert "\n" not in str(error.value)


def test_absent_file(folder):
    with pytest.raises(DataError, match="no such file"):
        read_ply(folder / "absent.ply")


def test_a_wrong_shift_comment_is_refused(folder):
    path = folder / "b.ply"
    write_ply(path, random_gaussians(2), torch.ones(3, dtype=torch.float64))
    path.write_bytes(path.read_bytes().replace(b"shift 1.0 1.0 1.0", b"shift 1.0 1.0 x.0"))
    with pytest.raises(DataError, match="expected three numbers"):
        read_ply(path)
