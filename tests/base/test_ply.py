"""Vertices of .ply files against plyfile, which is no part of the product for its licence."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement

from splatproof.base.errors import DataError
from splatproof.base.ply import read_vertices, write_vertices

KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")


def drawn(count: int, kinds: list[str], seed: int) -> np.ndarray:
    draw = np.random.default_rng(seed)
    rows = np.zeros(count, [(f"p{i}", kind) for i, kind in enumerate(kinds)])
    for name in rows.dtype.names or ():
        kind = rows.dtype[name]
        if kind.kind == "f":
            rows[name] = draw.normal(size=count)
        else:
            info = np.iinfo(kind)
            rows[name] = draw.integers(info.min, info.max, count, endpoint=True)
    return rows


@given(
    count=st.integers(0, 9),
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=6),
    seed=st.integers(0, 99),
    form=st.sampled_from(["text", "<", ">"]),
    faces=st.booleans(),
)
def test_what_plyfile_writes_is_read(tmp_path_factory, count, kinds, seed, form, faces):
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    rows = drawn(count, kinds, seed)
    elements = [PlyElement.describe(rows, "vertex")]
    if faces:
        face = np.zeros(2, [("vertex_indices", object)])
        face["vertex_indices"] = [np.array([0, 1, 2], "i4"), np.array([2, 1], "i4")]
        elements.append(PlyElement.describe(face, "face"))
    order = "<" if form == "text" else form
    PlyData(elements, text=form == "text", byte_order=order, comments=["one  two", ""]).write(path)
    found = read_vertices(path)
    assert found.comments == ("one  two", "")
    assert found.rows.dtype == rows.dtype
    for name in found.names:
        assert np.array_equal(found.rows[name], rows[name])


@given(kinds=st.lists(st.sampled_from(["u1", "i4", "f4", "f8"]), min_size=1, max_size=6),
       count=st.integers(0, 9))  # fmt: skip
def test_plyfile_reads_what_is_written(tmp_path_factory, kinds, count):
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    rows = drawn(count, kinds, count)
    write_vertices(path, rows, ["shift 1 2"])
    found = PlyData.read(path)
    assert list(found.comments) == ["shift 1 2"]
    assert np.array_equal(found["vertex"].data, rows)


HEAD = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty uchar x\nend_header\n"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "begin with 'ply'"),
        (b"plyformat", "no 'end_header'"),
        (HEAD + b"1", "2 vertices of 1 numbers"),
        (HEAD + b"1 256", "its type cannot hold"),
        (HEAD + b"1 0.5", "its type cannot hold"),
        (HEAD + b"1 a", "could not convert"),
        (HEAD.replace(b"2", b"9" * 18) + b"1 2", "bytes are there"),
        (HEAD.replace(b"vertex 2", b"vertex -1"), "header line"),
        (HEAD.replace(b"vertex", b"face"), "vertices first"),
        (HEAD.replace(b"uchar", b"list uchar int"), "without lists"),
        (HEAD.replace(b"uchar x", b"uchar x\nproperty uchar x"), "twice"),
        (HEAD.replace(b"ascii", b"binary_little_endian") + b"1", "1 bytes are there"),
        (HEAD.replace(b"format ascii 1.0\n", b""), "no format"),
    ],
)
def test_damage_is_told_in_one_line(tmp_path, data, said):
    (tmp_path / "a.ply").write_bytes(data)
    with pytest.raises(DataError, match=said) as caught:
        read_vertices(tmp_path / "a.ply")
    assert "\n" not in str(caught.value)


def test_lines_may_end_in_two_characters(tmp_path):
    (tmp_path / "a.ply").write_bytes((HEAD + b"7\n8\n").replace(b"\n", b"\r\n"))
    assert read_vertices(tmp_path / "a.ply").rows["x"].tolist() == [7, 8]
