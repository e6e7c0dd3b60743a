"""The .spz adapter: what comes back is within the format's steps."""

import builtins
import time

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError, MissingError
from splatproof.methods.gaussian_files import read_gaussians
from splatproof.methods.storage import spz
from splatproof.methods.storage.morton import morton_order
from splatproof.reference.types.gaussians import Gaussians


def in_order(model: Gaussians) -> Gaussians:
    """As they lie in the file."""
    order = morton_order(model.means)
    return Gaussians(**{name: values[order] for name, values in vars(model).items()})


@settings(max_examples=15)
@given(
    count=st.integers(1, 60), degree=st.integers(0, 3), seed=st.integers(0, 2**16),
    version=st.sampled_from([3, 4]), reach=st.sampled_from([1e-3, 1.0, 8.0, 4000.0]),
)  # fmt: skip
def test_what_comes_back_is_within_the_formats_steps(
    tmp_path_factory, count, degree, seed, version, reach
):
    path = tmp_path_factory.mktemp("spz") / "m.spz"
    whole = random_gaussians(count, degree=degree, seed=seed)
    whole.means[:] *= reach / whole.means.abs().max()
    spz.write_spz(path, whole, version=version)
    back, whole = spz.read_spz(path), in_order(whole)
    assert back.degree == degree
    # 24 bits over at most four times the extent, 23 of them fraction at most; half a step
    assert (back.means - whole.means).abs().max() <= max(2 * reach, 1) * 2.0**-23
    assert (back.log_scales - whole.log_scales).abs().max() <= 1 / 32 + 1e-6
    assert (back.opacities - whole.opacities).abs().max() <= 0.5 / 255 + 1e-6
    inside = whole.sh[:, 1:].abs() < 0.99
    assert ((back.sh - whole.sh)[:, 1:].abs()[inside] <= 1 / 16 + 1e-6).all()
    turned = (back.unit_quaternions * whole.unit_quaternions).sum(dim=1).abs()
    assert (turned > 1 - 1e-4).all()


def test_harmonics_in_the_usual_bits_are_off_by_half_a_bucket_and_half_as_large(tmp_path):
    whole = in_order(random_gaussians(2000, degree=3))
    sizes = []
    for bits in (spz.ALL_BITS, spz.USUAL_BITS):
        spz.write_spz(tmp_path / "m.spz", whole, version=4, harmonics=bits)
        back = spz.read_spz(tmp_path / "m.spz")
        sizes.append((tmp_path / "m.spz").stat().st_size)
    off = (back.sh - whole.sh).abs()
    inside = whole.sh.abs() < 0.9
    assert sizes[1] < 0.75 * sizes[0]
    for part, step in ((slice(1, 4), 8), (slice(4, None), 16)):
        stored = back.sh[:, part] * 128 + 128
        assert ((stored % step == 0) | (stored == 255)).all()
        worst = off[:, part][inside[:, part]].max()
        # half a bucket, and half a step of the byte before
        assert 0.9 * step / 256 < worst <= (step + 1) / 256 + 1e-6


@pytest.mark.parametrize("version", [3, 4])
def test_the_order_of_gaussians_changes_no_byte_and_neighbours_make_the_file_smaller(
    tmp_path, version
):
    whole = random_gaussians(3000, degree=0)
    whole.log_scales[:] = whole.means.sin()  # as trained ones, they change slowly along a surface
    whole.sh[:, 0] = whole.means.cos()
    whole.quaternions[:, 1:] = whole.means
    whole.opacity_logits[:] = whole.means[:, 1]
    whole.means[:, 2] = whole.means[:, 0].sin()
    mixed = Gaussians(**{name: values.flip(0) for name, values in vars(whole).items()})
    written = []
    for model in (whole, mixed):
        spz.write_spz(tmp_path / "m.spz", model, version=version)
        written.append((tmp_path / "m.spz").read_bytes())
    assert written[0] == written[1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spz, "morton_order", lambda means: torch.arange(len(means)))
        spz.write_spz(tmp_path / "m.spz", whole, version=version)
    assert len(written[0]) < (tmp_path / "m.spz").stat().st_size


@given(
    name=st.sampled_from(["log_scales", "dc", "rest"]), sign=st.sampled_from([-1, 1]),
    beyond=st.sampled_from([-3.0, -0.45, 0.45, 1.0, 1.6, 40.0]), hit=st.integers(1, 5),
)  # fmt: skip
@settings(max_examples=40)
def test_what_is_clipped_is_what_comes_back_off(tmp_path_factory, name, sign, beyond, hit):
    path = tmp_path_factory.mktemp("spz") / "m.spz"
    low, high, step = {"log_scales": spz.SCALES, "dc": spz.DC, "rest": spz.HARMONICS}[name]
    whole = in_order(random_gaussians(20, degree=2))
    whole.sh.clamp_(-0.9, 0.9)
    part = {"log_scales": whole.log_scales, "dc": whole.sh[:, 0], "rest": whole.sh[:, 1:]}[name]
    part[-hit:] = (high if sign > 0 else low) + sign * beyond * step
    spz.write_spz(path, whole)
    back = spz.read_spz(path)
    found = {"log_scales": back.log_scales, "dc": back.sh[:, 0], "rest": back.sh[:, 1:]}[name]
    off = ((found - part).abs() > step / 2 * (1 + 1e-3)).flatten(start_dim=1).any(dim=1)
    told = {"log_scales": "log scales", "dc": "colours", "rest": "harmonics"}[name]
    assert int(off.sum()) == (hit if beyond > 0.5 else 0)
    assert spz.clipped(whole) == ({told: hit} if beyond > 0.5 else {})


@pytest.mark.parametrize("version", [3, 4])
def test_the_same_model_gives_the_same_bytes_at_any_time(tmp_path, monkeypatch, version):
    written = []
    for seconds in (1e9, 2e9):
        monkeypatch.setattr(time, "time", lambda now=seconds: now)
        spz.write_spz(tmp_path / "m.spz", random_gaussians(40), version=version)
        written.append((tmp_path / "m.spz").read_bytes())
    assert written[0] == written[1]


def test_a_model_of_no_gaussians_is_refused_and_leaves_nothing(tmp_path):
    nothing = Gaussians(**{name: values[:0] for name, values in vars(random_gaussians(1)).items()})
    with pytest.raises(DataError, match=r"m\.spz: 0 Gaussians\. Expected at least one"):
        spz.write_spz(tmp_path / "m.spz", nothing)
    assert not list(tmp_path.iterdir())


def test_far_positions_missing_and_damaged_files_are_refused(tmp_path):
    far = random_gaussians(3)
    far.means[0] = 2.0**25
    with pytest.raises(DataError, match="positions up to"):
        spz.write_spz(tmp_path / "m.spz", far)
    assert not list(tmp_path.iterdir())
    with pytest.raises(DataError, match="m.spz"):
        spz.read_spz(tmp_path / "m.spz")
    (tmp_path / "m.spz").write_bytes(b"ply\n")
    with pytest.raises(DataError, match="not a whole"):
        spz.read_spz(tmp_path / "m.spz")


def test_without_the_package_it_is_said(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *args, **keywords):
        if name == "gsply":
            raise ImportError
        return real(name, *args, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingError, match="pip install"):
        spz.write_spz(tmp_path / "m.spz", random_gaussians(3))


@pytest.mark.parametrize("version", [3, 4])
def test_a_file_says_that_its_model_was_trained_antialiased(tmp_path, version):
    model, files = random_gaussians(40, degree=2), {}
    for mode in ("classic", "antialiased"):
        files[mode] = tmp_path / f"{mode}.spz"
        spz.write_spz(files[mode], model, version=version, mode=mode)
        assert spz.read_mode(files[mode]) == mode
        assert read_gaussians(files[mode])[1].mode == mode
    plain, marked = (spz.read_spz(path) for path in files.values())
    assert all(torch.equal(a, vars(marked)[name]) for name, a in vars(plain).items())
    stored = [path.read_bytes() for path in files.values()]
    if version == 4:  # one bit of one byte, and nothing else
        odd = [i for i, (a, b) in enumerate(zip(*stored, strict=True)) if a != b]
        assert odd == [spz.FLAGS]


@pytest.mark.parametrize("version", [3, 4])
def test_the_same_model_gives_the_same_bytes_antialiased_too(tmp_path, version, monkeypatch):
    model, written = random_gaussians(40), []
    for moment in (1e9, 2e9):
        monkeypatch.setattr(time, "time", lambda moment=moment: moment)
        spz.write_spz(tmp_path / "m.spz", model, version=version, mode="antialiased")
        written.append((tmp_path / "m.spz").read_bytes())
    assert written[0] == written[1]
