"""The .sog adapter: what comes back is within half a code, and another reader finds the same."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gsply import sog_reader
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from helpers.tiny_scene import random_gaussians
from splatproof.base import memory
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.methods.storage import sog, sog_bundle
from splatproof.methods.storage.morton import morton_order
from splatproof.reference.types.gaussians import Gaussians


def in_order(model: Gaussians) -> Gaussians:
    """As they lie in the file."""
    order = morton_order(model.means)
    return Gaussians(**{name: values[order] for name, values in vars(model).items()})


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def rewritten(path: Path, change: Callable[[dict[str, Any], dict[str, bytes]], None]) -> None:
    """The file with its meta.json or images changed."""
    images = members(path)
    meta = json.loads(images.pop("meta.json"))
    change(meta, images)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, content in images.items():
            archive.writestr(name, content)


def steps(model: Gaussians) -> torch.Tensor:
    """Distance of two codes at each position."""
    places = model.means.double().abs().log1p() * model.means.sign()
    reach = places.amax(dim=0) - places.amin(dim=0)
    # across half a step the slope grows too
    return reach / 65535 * (1 + model.means.double().abs()) * (reach / 65535).exp()


@settings(max_examples=25)
@given(
    count=st.integers(1, 60), degree=st.integers(0, 3), seed=st.integers(0, 2**16),
    reach=st.sampled_from([1e-3, 1.0, 8.0, 4000.0, 1e30]), mode=st.sampled_from(["classic", "antialiased"]),
)  # fmt: skip
def test_what_comes_back_is_within_half_a_code(tmp_path_factory, count, degree, seed, reach, mode):
    path = tmp_path_factory.mktemp("sog") / "m.sog"
    whole = random_gaussians(count, degree=degree, seed=seed)
    whole.means[:] *= reach / whole.means.abs().max()
    sog.write_sog(path, whole, mode, palette=64)
    back, told = sog.read_sog(path)
    whole = in_order(whole)
    assert (back.degree, told) == (degree, mode)
    off = (back.means - whole.means).double().abs()
    assert (off <= steps(whole) / 2 * (1 + 1e-6) + 1e-6 * whole.means.abs()).all()
    assert (back.opacities - whole.opacities).abs().max() <= 0.5 / 255 + 1e-6
    # three components of half a step, 1 / 255 of sqrt(2) each, and what they leave to the largest
    turned = (back.unit_quaternions * whole.unit_quaternions).sum(dim=1).abs()
    assert (turned > 1 - 4e-5).all()
    # up to 60 Gaussians have 180 scales and 180 colours: no level is shared
    assert torch.equal(back.log_scales, whole.log_scales)
    assert torch.equal(back.sh[:, 0], whole.sh[:, 0])
    meta = json.loads(members(path)["meta.json"])
    if degree:
        # every Gaussian has an entry of its own: the codebook alone is between
        assert meta["shN"]["count"] == count
        levels = torch.tensor(meta["shN"]["codebook"], dtype=torch.float32)
        rest = whole.sh[:, 1:].flatten()
        least = (rest[:, None] - levels).abs().amin(dim=1)
        assert torch.allclose((back.sh[:, 1:].flatten() - rest).abs(), least, atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3, 1023, 1024, 1025])
def test_images_and_palette_are_as_large_as_the_format_says(tmp_path, count):
    path = tmp_path / "m.sog"
    sog.write_sog(path, random_gaussians(count, degree=1))
    found = members(path)
    meta = json.loads(found["meta.json"])
    assert (meta["version"], meta["count"], meta["antialias"]) == (2, count, False)
    sizes = {}
    for name, content in found.items():
        if name != "meta.json":
            with Image.open(io.BytesIO(content)) as image:
                sizes[name] = image.size
    entries = meta["shN"]["count"]
    assert entries == 2 ** int(np.log2(count)) <= count
    assert sizes.pop("shN_centroids.webp") == (64 * 3, -(-entries // 64))
    width = int(np.ceil(np.sqrt(count) / 4)) * 4
    assert set(sizes.values()) == {(width, int(np.ceil(count / width / 4)) * 4)}
    assert len(sog.read_sog(path)[0]) == count


@pytest.mark.parametrize(
    ("count", "entries"), [(1, 1), (1023, 512), (1024, 1024), (58_407, 32_768), (10**7, 65_536)]
)
def test_the_palette_is_as_large_as_the_formats_own_encoder_makes_it(count, entries):
    assert sog.usual_entries(count) == entries
    if count >= 1024:
        assert entries == min(64, 2 ** int(np.log2(count / 1024))) * 1024


@pytest.mark.parametrize("degree", range(4))
def test_another_reader_finds_the_same(tmp_path, monkeypatch, degree):
    """gsply's, with Pillow's WebP in place of imagecodecs'."""

    class Decoder:
        @staticmethod
        def webp_decode(data: bytes) -> np.ndarray:
            return np.asarray(Image.open(io.BytesIO(data)))

    monkeypatch.setattr(sog_reader, "imagecodecs", Decoder)
    path = tmp_path / "m.sog"
    whole = random_gaussians(3000, degree=degree)
    whole.opacity_logits[:100] = 20.0
    whole.opacity_logits[100:200] = -20.0
    sog.write_sog(path, whole)
    back, other = sog.read_sog(path)[0], sog_reader.sogread(path)
    want = {"means": back.means, "quats": back.quaternions, "scales": back.log_scales,
            "sh0": back.sh[:, 0], "shN": back.sh[:, 1:]}  # fmt: skip
    for name, values in want.items():
        assert np.allclose(getattr(other, name), values.numpy(), atol=2e-6, rtol=2e-6), name
    # float32 holds 1 - 1e-6 within 6e-8, which is 0.06 of its logit
    assert np.allclose(other.opacities, back.opacity_logits.numpy(), atol=0.07)


def test_labels_of_gaussians_without_opacity_survive(tmp_path):
    """A pixel of no alpha has colours too, which encoders of photos throw away."""
    whole = random_gaussians(200, degree=0)
    whole.opacity_logits[::2] = -30.0
    sog.write_sog(tmp_path / "m.sog", whole)
    back, want = sog.read_sog(tmp_path / "m.sog")[0], in_order(whole)
    assert ((back.sh - want.sh).abs() <= 0.01).all()
    assert (back.opacities < 1.1e-6).sum() == 100
    assert sog.at_the_ends(whole) == {"0": 100}


def test_equal_and_extreme_values(tmp_path):
    path = tmp_path / "m.sog"
    whole = random_gaussians(5000, degree=1)
    for values in vars(whole).values():
        values[:] = values[:1].clone()
    sog.write_sog(path, whole)
    back = sog.read_sog(path)[0]
    for name in ("log_scales", "sh"):
        assert torch.equal(getattr(back, name), getattr(whole, name)), name
    assert torch.allclose(back.means, whole.means)
    largest = torch.finfo(torch.float32).max
    whole = random_gaussians(5000, degree=1)
    whole.means[0], whole.means[1] = largest, -largest
    whole.sh[2], whole.sh[3] = largest, -largest
    whole.log_scales[4], whole.opacity_logits[5], whole.quaternions[6] = 80.0, largest, 0.0
    sog.write_sog(path, whole)
    back, whole = sog.read_sog(path)[0], in_order(whole)
    assert torch.allclose(
        back.means[whole.means.abs() == largest], whole.means[whole.means.abs() == largest]
    )
    assert (back.sh[whole.sh == largest] == largest).all()
    # a rotation of nothing is the identity
    none = (whole.quaternions == 0).all(dim=1)
    assert (back.unit_quaternions[none, 0] > 0.9999).all()


def test_a_palette_of_more_entries_is_nearer(tmp_path):
    whole = in_order(random_gaussians(3000, degree=2))
    off, sizes = [], []
    for entries in (16, 256, 2048, 65_536):
        sog.write_sog(tmp_path / "m.sog", whole, palette=entries)
        back = sog.read_sog(tmp_path / "m.sog")[0]
        off.append(float((back.sh - whole.sh)[:, 1:].square().mean()))
        sizes.append((tmp_path / "m.sog").stat().st_size)
    assert off == sorted(off, reverse=True)
    assert sizes == sorted(sizes)
    assert off[-1] < 1e-3 * off[0]


def test_the_same_model_gives_the_same_bytes_on_any_number_of_threads(tmp_path):
    whole = random_gaussians(4000, degree=3)
    mixed = Gaussians(**{name: values.flip(0) for name, values in vars(whole).items()})
    written, threads = [], torch.get_num_threads()
    for model, number in ((whole, 1), (mixed, 2)):
        torch.set_num_threads(number)
        sog.write_sog(tmp_path / "m.sog", model)
        written.append((tmp_path / "m.sog").read_bytes())
    torch.set_num_threads(threads)
    assert written[0] == written[1]
    with zipfile.ZipFile(tmp_path / "m.sog") as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert {info.compress_type for info in archive.infolist()} == {zipfile.ZIP_STORED}


def test_what_cannot_be_written_is_refused_and_leaves_nothing(tmp_path, monkeypatch):
    path, whole = tmp_path / "m.sog", random_gaussians(3)
    nothing = Gaussians(**{name: values[:0] for name, values in vars(whole).items()})
    with pytest.raises(DataError, match=r"m\.sog: 0 Gaussians\. Expected at least one"):
        sog.write_sog(path, nothing)
    for entries in (0, 65_537):
        with pytest.raises(UsageError, match="1 to 65536 entries"):
            sog.write_sog(path, whole, palette=entries)
    with monkeypatch.context() as patch:
        patch.setattr(sog, "MOST_SIDE", 3)
        with pytest.raises(DataError, match="write a .ply"):
            sog.write_sog(path, whole)
    whole.means[1, 2] = torch.nan
    with pytest.raises(DataError, match=r"m\.sog: means of Gaussian 1 is not finite"):
        sog.write_sog(path, whole)
    assert not list(tmp_path.iterdir())


def codebook(part: str, values: list) -> Callable[[dict, dict], None]:
    return lambda meta, images: meta[part].update(codebook=values)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda meta, images: meta.update(version=3), "version 3 of SOG, expected 2"),
        (lambda meta, images: meta.pop("version"), "version None of SOG, expected 2"),
        (lambda meta, images: meta.update(count=True), "says count True, expected a whole number"),
        (lambda meta, images: meta.update(count=0), "says count 0, expected a whole number"),
        (lambda meta, images: meta.update(count=10**9), r"means_l\.webp is 12 x 8 pixels, expected at least 1000000000"),
        (lambda meta, images: meta.pop("quats"), r"not a whole \.sog file \('quats'\)"),
        (lambda meta, images: images.pop("quats.webp"), r"no quats\.webp in it"),
        (lambda meta, images: meta["quats"].update(files=["../../x"]), r"names '\.\./\.\./x', expected a file of the"),
        (lambda meta, images: meta["quats"].update(files=["/etc/passwd"]), "names '/etc/passwd'"),
        (lambda meta, images: meta["means"].update(files=["means_l.webp"]), r"says means\.files \['means_l"),
        (lambda meta, images: images.update({"quats.webp": b"PNG"}), "quats.webp begins with b'PNG'"),
        (lambda meta, images: images.update({"quats.webp": images["quats.webp"][:-9]}), "no whole lossless image"),
        (lambda meta, images: images.update({"quats.webp": images["sh0.webp"]}), r"rotation of Gaussian \d+ says \d+ in alpha"),
        (codebook("scales", [0.0] * 255), "says 255 values of scales.codebook, expected 256 numbers"),
        (codebook("sh0", [float("nan")] * 256), "says nan in sh0.codebook, expected a finite"),
        (codebook("shN", ["1"] * 256), "says '1' in shN.codebook, expected a finite"),
        (codebook("shN", [1e39] * 256), "says 1e.39 in shN.codebook, expected a finite"),
        (lambda meta, images: meta["means"].update(maxs=[0.0, 0.0, 1e3]), "expected logarithms up to 88.7"),
        (lambda meta, images: meta["means"].update(mins=[0.0]), "says 1 values of means.mins, expected 3"),
        (lambda meta, images: meta["shN"].update(count=2), r"harmonics of Gaussian \d+ are entry \d+ of a palette of 2"),
        (lambda meta, images: meta["shN"].update(count=65_536), "expected 512 x 1024 for 65536 entries"),
        (lambda meta, images: meta["shN"].update(bands=3), "expected 960 x 2 for 70 entries"),
        (lambda meta, images: meta["shN"].update(bands=4), r"says shN\.bands 4, expected a whole number from 1 to 3"),
    ],
)  # fmt: skip
def test_damaged_files_are_refused_by_name(tmp_path, change, said):
    path = tmp_path / "m.sog"
    sog.write_sog(path, random_gaussians(70, degree=2), palette=70)
    rewritten(path, lambda meta, images: None)
    sog.read_sog(path)
    rewritten(path, change)
    with pytest.raises(DataError, match=said) as caught:
        sog.read_sog(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_files_that_are_no_bundles_are_refused(tmp_path):
    path = tmp_path / "m.sog"
    with pytest.raises(DataError, match=r"m\.sog: no such file"):
        sog.read_sog(path)
    sog.write_sog(path, random_gaussians(9, degree=1))
    whole = path.read_bytes()
    for size in range(0, len(whole), 211):
        path.write_bytes(whole[:size])
        with pytest.raises(DataError, match=r"m\.sog: "):
            sog.read_sog(path)
    for name, content, said in (
        ("x", b"", r"no meta\.json in it|There is no item"), ("meta.json", b"[1]", "is list, expected an object"),
        ("meta.json", b"[" * 100_000, "not a whole"), ("meta.json", b" " * 2**21, "of more than 1048576 bytes"),
    ):  # fmt: skip
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(name, content)
        with pytest.raises(DataError, match=said):
            sog.read_sog(path)


def test_a_deflated_bundle_and_images_with_more_in_them_are_read(tmp_path):
    path = tmp_path / "m.sog"
    sog.write_sog(path, random_gaussians(40, degree=1))
    want, found = sog.read_sog(path)[0], members(path)
    chunk = found["sh0.webp"][12:]
    # an extended file: header, something unknown, the image
    head = (
        b"VP8X"
        + (10).to_bytes(4, "little")
        + bytes(10)
        + b"ODD "
        + (3).to_bytes(4, "little")
        + b"abc\0"
    )
    body = b"WEBP" + head + chunk
    found["sh0.webp"] = b"RIFF" + len(body).to_bytes(4, "little") + body
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in found.items():
            archive.writestr(name, content)
    back = sog.read_sog(path)[0]
    assert torch.equal(back.sh, want.sh)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        for name, content in found.items():
            archive.writestr(name, content)
    with pytest.raises(DataError, match="packed in way 14, expected"):
        sog.read_sog(path)


def test_a_small_file_that_claims_many_gaussians(tmp_path, monkeypatch):
    """Images of one colour take next to no bytes, however large they are."""
    path, side = tmp_path / "m.sog", 4000
    sog.write_sog(path, random_gaussians(9, degree=1))
    blank = sog_bundle.webp(np.full((side * side, 4), 255, dtype=np.uint8), side, side)
    assert len(blank) < 1000

    def grown(meta: dict, images: dict) -> None:
        meta["count"] = side * side
        for name in images:
            if name != "shN_centroids.webp":
                images[name] = blank

    rewritten(path, grown)
    monkeypatch.setattr(sog_bundle.cv2, "imdecode", None)  # nothing is decoded
    with pytest.raises(DataError, match=r"m\.sog: says that its \d+ bytes hold \d+ MB"):
        sog.read_sog(path)


def test_the_numbers_need_room(tmp_path, monkeypatch):
    path = tmp_path / "m.sog"
    sog.write_sog(path, random_gaussians(2000, degree=3), palette=64)
    monkeypatch.setattr(memory, "available_mb", lambda: 1.0)
    with pytest.raises(MissingError, match=r"m\.sog: takes \d+ MB to read"):
        sog.read_sog(path)
