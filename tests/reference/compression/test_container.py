"""The compressed file: exact round trips, and every kind of broken file refused."""

import hashlib
import math
import struct
from dataclasses import replace

import pytest
import torch
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.sh_models import model
from splatproof.base.errors import DataError
from splatproof.reference.compression import container, packing, spectral
from splatproof.reference.compression.packing import AS_RELEASED, PackedModel, PackSettings

SEEDS = st.integers(0, 2**16)
DEGREES = st.integers(0, 3)
OURS = PackSettings()


def same(a: PackedModel, b: PackedModel) -> bool:
    """Bit for bit equal, dtypes and shapes included."""
    pairs = [
        (getattr(a, n), getattr(b, n))
        for n in ("means", "opacity_logits", "quaternions", "log_scales", "dc")
    ]
    pairs += [(getattr(a.rest, n), getattr(b.rest, n)) for n in ("codes", "low", "range")]
    return all(x.dtype == y.dtype and x.shape == y.shape and torch.equal(x, y) for x, y in pairs)


@settings(max_examples=40)
@given(
    count=st.integers(0, 30), degree=DEGREES, seed=SEEDS, how=st.sampled_from(container.PACKINGS)
)
def test_files_open_to_the_same_arrays_and_encode_to_the_same_file(count, degree, seed, how):
    packed = packing.pack(model(count, degree, seed), OURS)
    data = container.encode(packed, how)
    opened = container.decode(data)
    assert same(opened, packed)
    assert container.encode(opened, how) == data


@settings(max_examples=30)
@given(count=st.integers(0, 30), degree=DEGREES, seed=SEEDS, gate=st.sampled_from([0.0, 0.02, 9.0]))
def test_packing_loses_only_what_the_formats_lose(count, degree, seed, gate):
    whole = model(count, degree, seed)
    packed = packing.pack(whole, replace(OURS, gate=gate))
    back = packing.unpack(packed)
    assert back.degree == degree
    assert torch.equal(back.means, whole.means)
    half = torch.finfo(torch.float16)
    for name in ("opacity_logits", "log_scales"):
        assert_close(getattr(back, name), getattr(whole, name), rtol=half.eps, atol=half.tiny)
    assert_close(back.quaternions, whole.unit_quaternions, rtol=half.eps, atol=half.tiny)
    assert_close(back.sh[:, 0], whole.sh[:, 0], rtol=half.eps, atol=half.tiny)
    kept = spectral.gated(whole.sh[:, 1:], gate)
    step = packed.rest.range.reshape(kept.shape[1:]) / 510
    assert ((back.sh[:, 1:] - kept).abs() <= step * 1.001 + 1e-6).all()


def test_the_release_stores_79_bytes_a_primitive_of_degree_3():
    # 12 position, 2 opacity, 8 rotation, 6 scale, 6 DC, 45 codes; the lattice is 2 * 45 * 4 more.
    packed = packing.pack(model(100, 3, 0), AS_RELEASED)
    assert len(container.encode(packed, "none")) == container.HEADER.size + 360 + 79 * 100
    assert len(container.encode(packed)) < len(container.encode(packed, "none"))


def test_gated_models_pack_smaller():
    sizes = [
        len(container.encode(packing.pack(model(500, 3, 1), replace(OURS, gate=gate))))
        for gate in (0.0, 0.04, 9.0)
    ]
    assert sizes[0] > sizes[1] > sizes[2]


def test_the_release_truncates_codes():
    whole = model(300, 3, 2)
    ours, theirs = (packing.pack(whole, s).rest.codes.double() for s in (OURS, AS_RELEASED))
    assert ((ours - theirs >= 0) & (ours - theirs <= 1)).all()
    assert float((ours - theirs).mean()) > 0.1


FILE = container.encode(packing.pack(model(20, 2, 3), OURS))


@settings(max_examples=60)
@given(length=st.integers(0, len(FILE) - 1))
def test_a_cut_file_is_refused(length):
    with pytest.raises(DataError):
        container.decode(FILE[:length])


@settings(max_examples=150)
@given(place=st.integers(0, len(FILE) - 1), bit=st.integers(0, 7))
def test_a_flipped_bit_anywhere_is_refused(place, bit):
    altered = bytearray(FILE)
    altered[place] ^= 1 << bit
    with pytest.raises(DataError):
        container.decode(bytes(altered))


@settings(max_examples=60)
@given(data=st.binary(max_size=200), head=st.booleans())
def test_random_bytes_are_refused(data, head):
    with pytest.raises(DataError):
        container.decode((b"SPGS" if head else b"") + data)


def forged(payload: bytes, *, version: int = 1, degree: int = 2, packed: int = 1, count: int = 20,
           size: int | None = None) -> bytes:  # fmt: skip
    """A file with a right checksum whatever it claims, as an attacker would write it."""
    size = len(payload) if size is None else size
    head = struct.pack("<4sHBBQQ", b"SPGS", version, degree, packed, count, size)
    return head + hashlib.sha256(head + payload).digest() + payload


BODY = FILE[container.HEADER.size :]


def test_the_forger_can_make_a_good_file():
    assert forged(BODY) == FILE


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "not a compressed model"),
        (b"PK\x03\x04" + FILE[4:], "not a compressed model"),
        (forged(BODY, version=2), "version 2"),
        (forged(BODY, version=0), "version 0"),
        (forged(BODY, degree=4), "degree 4"),
        (forged(BODY, packed=2), "packing 2"),
        (forged(BODY, size=len(BODY) + 1), "expected"),
        (FILE + b"x", "expected"),
        (forged(BODY, count=21), "bytes of arrays"),
        (forged(BODY, degree=1), "bytes of arrays"),
        (forged(BODY, packed=0), "bytes of arrays"),
        (forged(BODY, count=2**63), "limit"),
        (forged(b"not zstd"), "does not unpack"),
        (forged(BODY[:-4]), "does not unpack"),
        (forged(BODY + BODY), "does not unpack"),
    ],
)
def test_forged_files_are_refused_by_what_is_wrong(data, said):
    with pytest.raises(DataError, match=said):
        container.decode(data)


def test_a_bomb_is_refused_before_it_unpacks(monkeypatch):
    count = 2_000_000  # degree 0: 34 bytes each, 68 MB of zeros in a few kB
    bomb = forged(
        zstandard.ZstdCompressor(level=19).compress(bytes(34 * count)), degree=0, count=count
    )
    assert len(bomb) < 20_000
    monkeypatch.setattr(container.zstandard, "ZstdDecompressor", None)  # a call would fail the test
    with pytest.raises(DataError, match="limit is 1000000"):
        container.decode(bomb, most_bytes=1_000_000)
    # A modest claim over the same payload is caught by the frame's own size.
    liar = forged(bomb[container.HEADER.size :], degree=0, count=10)
    with pytest.raises(DataError, match="bytes of arrays"):
        container.decode(liar, most_bytes=1_000_000)


def test_the_limit_is_inclusive():
    size = 20 * (12 + 2 + 8 + 6 + 6 + 24) + 24 * 8
    assert same(container.decode(FILE, most_bytes=size), container.decode(FILE))
    with pytest.raises(DataError, match="limit"):
        container.decode(FILE, most_bytes=size - 1)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("opacity_logits", 7e4, "opacity logit"),
        ("opacity_logits", math.inf, "opacity logit"),
        ("log_scales", 1e5, "log scale"),
        ("log_scales", -math.inf, "log scale"),
        ("sh", 1e5, "SH DC"),
        ("sh", math.nan, "SH"),
        ("means", math.inf, "positions"),
        ("quaternions", math.nan, "rotation"),
    ],
)
def test_numbers_that_do_not_fit_are_refused_by_name(field, value, said):
    whole = model(4, 1, 0)
    spoilt = getattr(whole, field).clone()
    spoilt.view(-1)[0] = value
    with pytest.raises(DataError, match=said):
        packing.pack(replace(whole, **{field: spoilt}), OURS)


def test_a_nan_in_the_residual_does_not_hide_behind_the_gate():
    whole = model(4, 1, 0)
    whole.sh[2, 3, 1] = math.nan
    with pytest.raises(DataError, match="SH"):
        packing.pack(whole, OURS)


def test_zero_and_huge_quaternions_survive():
    whole = replace(model(2, 0, 0), quaternions=torch.tensor([[0.0, 0, 0, 0], [3e6, 0, 4e6, 0]]))
    back = packing.unpack(packing.pack(whole, OURS))
    assert_close(back.quaternions[1], torch.tensor([0.6, 0, 0.8, 0]), atol=1e-3, rtol=0)
    assert back.quaternions[0].tolist() == [0, 0, 0, 0]
