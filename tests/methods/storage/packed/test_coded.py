"""The small file: what comes back, that it stays, what it costs, and that damage is refused."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.baking import baked
from helpers.sh_models import model
from splatproof.base.errors import DataError
from splatproof.base.memory import GROWTH, SMALL
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.loading import load_origin, load_reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.packed import coded_chunk, coded_reader, coded_writer
from splatproof.methods.storage.packed.coded_writer import CodeSettings, chosen_steps, write_coded
from splatproof.methods.storage.packed.reader import read_packed, unpack_packed
from splatproof.methods.storage.packed.records import CODED, RecordWriter, records
from splatproof.methods.storage.packed.rows import FolderRows, MemoryRows
from splatproof.methods.storage.packed.writer import NAMES, PackedFacts, write_packed
from splatproof.reference.types.gaussians import Gaussians

PROFILES = st.sampled_from(["small", "fast"])
SEEDS = st.integers(0, 2**16)


def same(a: Gaussians, b: Gaussians) -> bool:
    return all(torch.equal(getattr(a, name), getattr(b, name)) for name in NAMES)


def small_model(count: int, degree: int, seed: int, shape: str = "") -> Gaussians:
    whole = model(count, degree, seed)
    means = whole.means / 1e3
    if shape == "equal":
        means[:] = torch.tensor([5.0, -7.0, 0.25])
    if shape == "flat":
        means[:, 1] = 3.0
    return replace(whole, means=means)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("coded")


@settings(max_examples=20)
@given(
    count=st.sampled_from([0, 1, 2, 15, 16, 17, 60]), degree=st.integers(0, 3), seed=SEEDS,
    profile=PROFILES, shape=st.sampled_from(["", "equal", "flat"]), chunk=st.sampled_from([16, 2**16]),
)  # fmt: skip
def test_all_is_within_its_step_and_packs_to_the_same_file(
    folder, count, degree, seed, profile, shape, chunk
):
    whole, path, kept = (
        small_model(count, degree, seed, shape),
        folder / "m",
        CodeSettings(profile=profile),
    )
    steps = chosen_steps(MemoryRows(whole), kept)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(coded_writer.CHUNK, profile, chunk)
        patch.setattr(coded_writer, "LOOKED", chunk)
        report = write_coded(path, whole, settings=kept, threads=2)
        found, _ = read_packed(path, threads=2)
        write_coded(folder / "again", found, settings=kept, steps=steps)
    assert (folder / "again").read_bytes() == path.read_bytes()
    assert report.bytes == path.stat().st_size
    assert report.primitives == count == len(found)
    cells = torch.from_numpy(np.rint(whole.means.double().numpy() / steps.position)).long()
    cells -= cells.amin(dim=0) if count else 0
    order = codes_of(cells.numpy()).argsort(kind="stable")
    rounded = 1e-6  # float32's own
    for name, step in (("means", steps.position), ("log_scales", 0.1), ("opacity_logits", 0.1)):
        most = 12 if name == "opacity_logits" else torch.inf
        want = getattr(whole, name)[order].clamp(-most, most)
        error = (getattr(found, name) - want).abs()
        assert (error <= step / 2 * (1 + 1e-5) + rounded * (1 + want.abs())).all(), name
    assert ((found.sh[:, 0] - whole.sh[order, 0]).abs() <= 0.025 + 1e-5).all()


def codes_of(cells: np.ndarray) -> np.ndarray:
    """Places on the Morton curve, bit by bit."""
    found = np.zeros(len(cells), dtype=np.int64)
    for bit in range(21):
        for axis in range(3):
            found |= (cells[:, axis].astype(np.int64) >> bit & 1) << (3 * bit + axis)
    return found


@given(count=st.integers(0, 40), seed=SEEDS)
@settings(max_examples=8)
def test_both_profiles_hold_the_same_model(folder, count, seed):
    whole = small_model(count, 2, seed)
    for profile in ("small", "fast"):
        write_coded(folder / profile, whole, settings=CodeSettings(profile=profile))
    assert same(read_packed(folder / "small")[0], read_packed(folder / "fast")[0])


def test_threads_and_folders_change_no_bit(tmp_path, monkeypatch):
    monkeypatch.setitem(coded_writer.CHUNK, "small", 16)
    monkeypatch.setattr(coded_writer, "LOOKED", 16)
    whole = small_model(90, 3, 0)
    save_model(ExplicitModel(model=whole), tmp_path / "model", Origin())
    for threads in (1, 3):
        write_coded(tmp_path / str(threads), whole, threads=threads)
    write_coded(tmp_path / "disk", FolderRows(tmp_path / "model"))
    written = (tmp_path / "1").read_bytes()
    assert (tmp_path / "3").read_bytes() == written == (tmp_path / "disk").read_bytes()
    found = read_packed(tmp_path / "1", threads=1)[0]
    assert same(read_packed(tmp_path / "1", threads=3)[0], found)
    assert unpack_packed(tmp_path / "1", tmp_path / "back") == 90
    assert same(baked(load_reconstruction(tmp_path / "back")), found)


@given(count=st.integers(0, 2000), most=st.integers(1, 50), profile=PROFILES)
def test_chunks_are_as_few_as_may_be_and_equally_large(count, most, profile):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(coded_writer.CHUNK, profile, most)
        size = coded_writer.chunk_size(count, profile)
    chunks = [min(size, count - first) for first in range(0, count, size)]
    assert 1 <= size <= most
    assert len(chunks) == -(-count // most)
    assert sum(chunks) == count
    assert not chunks or size - chunks[-1] < len(chunks)


def test_facts_come_back(tmp_path):
    origin = Origin(method="3dgs", settings={"iterations": 5}, scene="tiny", seed=3)
    facts = PackedFacts(
        mode="antialiased", shift=torch.tensor([5e5, 4.2e6, 0.1], dtype=torch.float64),
        units="metres", origin=origin,
    )  # fmt: skip
    write_coded(tmp_path / "f.spgs", small_model(20, 1, 0), facts=facts)
    back = load_reconstruction(tmp_path / "f.spgs", backend="reference")
    assert isinstance(back, ExplicitModel)
    assert (back.mode, back.units) == ("antialiased", "metres")
    assert torch.equal(back.shift, facts.shift)
    assert load_origin(tmp_path / "f.spgs") == origin


def smooth(count: int) -> Gaussians:
    """Gaussians on a surface whose parameters change slowly along it, as trained ones do."""
    g = torch.Generator().manual_seed(0)
    at, whole = torch.rand(count, 2, generator=g), small_model(count, 2, 0)
    wave = torch.stack([(k * at).sin().sum(dim=1) for k in range(1, 5)], dim=1)
    noise = 0.1 * torch.randn(count, 3, generator=g)
    return replace(
        whole, means=torch.cat([100 * at, wave[:, :1]], dim=1), log_scales=wave[:, 1:] + noise,
        quaternions=torch.tensor([1.0, 0, 0, 0]) + 0.1 * wave, opacity_logits=wave[:, 0],
        sh=torch.cat([wave[:, None, 1:], 0.05 * whole.sh[:, 1:]], dim=1),
    )  # fmt: skip


def test_it_is_a_third_of_the_version_before_and_contexts_pay(folder):
    whole = smooth(8000)
    before = write_packed(folder / "old", whole).bytes
    small = write_coded(folder / "small", whole)
    fast = write_coded(folder / "fast", whole, settings=CodeSettings(profile="fast"))
    assert small.bytes * 3 < before
    assert small.bytes * 1.05 < fast.bytes


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("log_scales", 7e4, "log scale"), ("log_scales", torch.inf, "log scale"),
        ("opacity_logits", torch.inf, "opacity logit"), ("opacity_logits", -torch.inf, "opacity logit"),
        ("opacity_logits", torch.nan, "opacity logit"), ("sh", 1e5, "SH"),
        ("means", torch.inf, "positions"), ("sh", torch.nan, "SH"), ("quaternions", torch.nan, "rotation"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("profile", ["small", "fast"])
def test_numbers_that_do_not_fit_are_refused_and_leave_nothing(
    tmp_path, profile, name, value, said
):
    whole = small_model(40, 1, 0)
    getattr(whole, name)[33] = value
    with pytest.raises(DataError, match=said):
        write_coded(tmp_path / "m", whole, settings=CodeSettings(profile=profile))
    assert not list(tmp_path.iterdir())


def test_codes_that_span_more_than_fits_are_refused(tmp_path):
    whole = small_model(40, 1, 0)
    whole.log_scales[3] = 500.0
    with pytest.raises(DataError, match="log scales: span more"):
        write_coded(tmp_path / "m", whole)


@pytest.mark.parametrize("change", [{"position": 0.0}, {"rotation_bits": 13}, {"dc": float("nan")}])
def test_settings_that_no_file_can_have_are_refused(change):
    with pytest.raises(DataError, match=next(iter(change))):
        CodeSettings(**change)


def refused(folder: Path, data: bytes) -> str:
    (folder / "broken").write_bytes(data)
    with pytest.raises(DataError) as error:
        read_packed(folder / "broken")
    assert "broken" in str(error.value)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.fixture(scope="module", params=["small", "fast"])
def intact(request, folder) -> bytes:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(coded_writer.CHUNK, request.param, 16)
        write_coded(
            folder / "intact", small_model(40, 2, 3), settings=CodeSettings(profile=request.param)
        )
    return (folder / "intact").read_bytes()


@settings(max_examples=40)
@given(share=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_cut_files_and_flipped_bits_are_refused(folder, intact, share, bit):
    place = int(share * len(intact))
    refused(folder, intact[:place])
    data = bytearray(intact)
    data[place] ^= 1 << bit
    refused(folder, bytes(data))


def forged(folder: Path, intact: bytes, change: dict, chunks: list[bytes] | None = None) -> str:
    """Refusal of a file with right seals whatever it claims, as an attacker would write it."""
    (folder / "whole").write_bytes(intact)
    head, *parts = records(folder / "whole")
    with (folder / "forged").open("wb") as file:
        out = RecordWriter(file, CODED)
        for content in [json.dumps(json.loads(head) | change).encode(), *(chunks or parts)]:
            out.add(content)
    return refused(folder, (folder / "forged").read_bytes())


STEPS = asdict(chosen_steps(MemoryRows(small_model(40, 2, 3)), CodeSettings()))


@pytest.mark.parametrize(
    "change",
    [
        {"primitives": 2**50}, {"primitives": -1}, {"primitives": 39}, {"bands": 16}, {"bands": 5},
        {"chunk": 0}, {"chunk": 15}, {"chunk": 2**16 + 1}, {"corner": [0, 0]}, {"corner": [0, 0, 2**40]}, {"corner": [0, 0, 0.5]},
        {"packing": {}}, {"packing": {"profile": "none"}}, {"steps": {}}, {"steps": STEPS | {"dc": "1"}},
        {"steps": STEPS | {"position": 1e300}}, {"steps": STEPS | {"rotation_bits": 64}},
        {"steps": STEPS | {"weights": [1]}}, {"steps": STEPS | {"weights": [0, 2**30, 0, 0, 0, 0]}},
        {"steps": STEPS | {"more": 1}}, {"steps": STEPS | {"weights": 3}},
    ],
)  # fmt: skip
def test_forged_headers_are_refused(folder, intact, change):
    forged(folder, intact, change)


def test_forged_chunks_are_refused(folder, intact):
    (folder / "whole").write_bytes(intact)
    _, first, *others = records(folder / "whole")
    for bad in (b"", first[:-1], first + b"\0", b"\0" * len(first), first[:4] + b"\0" * 60):
        assert "chunk" in forged(folder, intact, {}, [bad, *others])
    assert "chunks" in forged(folder, intact, {}, [first])


def test_a_claim_beyond_the_limit_is_refused(folder):
    write_coded(folder / "big", small_model(500, 3, 0))
    with pytest.raises(DataError, match="over 1000 bytes"):
        read_packed(folder / "big", most_bytes=1000)


def test_equal_gaussians_however_many_are_read_again(tmp_path):
    one, path = small_model(1, 3, 0), tmp_path / "m.spgs"
    many = {name: values.expand(300_000, *values.shape[1:]) for name, values in vars(one).items()}
    stored = write_coded(path, Gaussians(**many), settings=CodeSettings(profile="fast")).bytes
    assert 4 * 59 * 300_000 > max(GROWTH * stored, SMALL)  # more than a file of version 2 may grow
    found, _ = read_packed(path)
    assert len(found) == 300_000
    assert all((values == values[:1]).all() for values in vars(found).values())


def test_no_writer_makes_larger_chunks_than_are_read():
    assert max(coded_writer.CHUNK.values()) <= coded_reader.MOST_CHUNK


@pytest.mark.parametrize("count", [2**16 - 1, 2**16, 2**16 + 1])
def test_chunks_end_where_they_should(folder, count):
    write_coded(folder / "c", small_model(count, 0, 0), settings=CodeSettings(profile="fast"))
    assert len(read_packed(folder / "c")[0]) == count
    assert len(list(records(folder / "c"))) == 1 + (1 if count <= 2**16 else 2)


def test_a_native_stream_is_read_by_the_reference(monkeypatch):
    from splatproof.reference.compression import columns, gaps, harmonics, quantisers

    whole, kept = small_model(30, 1, 4), CodeSettings()
    steps = chosen_steps(MemoryRows(whole), kept)
    corner = quantisers.cells(whole.means.double().numpy(), steps.position).min(axis=0)
    codes = coded_chunk.quantise(whole, steps, corner)
    order = gaps.morton_of_cells(codes.cells).argsort(kind="stable")
    whole = Gaussians(**{name: getattr(whole, name)[order] for name in NAMES})
    codes = coded_chunk.quantise(whole, steps, corner)
    streams = coded_chunk.write_streams(codes, steps, "small")
    for module in (columns, gaps, harmonics):
        for name in vars(module):
            if hasattr(coded_chunk.codec, name) and name[:6] in ("encode", "decode"):
                monkeypatch.setattr(coded_chunk.codec, name, getattr(module, name))
    assert coded_chunk.write_streams(codes, steps, "small") == streams
    back = coded_chunk.read_streams(streams, 30, codes.rest.shape[0], steps, "small")
    for name, want in vars(codes).items():
        assert np.array_equal(getattr(back, name), want), name
