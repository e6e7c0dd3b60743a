"""Photos that are bombs, of formats that would lose bits or colours, or damaged."""

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import ExifTags, Image

from splatproof.base import memory
from splatproof.base.errors import DataError, MissingError
from splatproof.base.memory import peak_memory_mb
from splatproof.datasets.ingesting.survey import survey_photos
from splatproof.datasets.photos import check_photo, photo_size, read_photo


def png(
    width: int, height: int, depth: int, colours: int, pixels: bytes, interlaced: int = 0
) -> bytes:
    """A PNG with that header around pixels that may be of another size."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        whole = kind + content
        return struct.pack(">I", len(content)) + whole + struct.pack(">I", zlib.crc32(whole))

    header = struct.pack(">IIBBBBB", width, height, depth, colours, 0, 0, interlaced)
    parts = (chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(pixels, 9)), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def test_a_header_that_says_more_than_its_file_can_hold(tmp_path):
    path = tmp_path / "small.png"
    path.write_bytes(png(30_000, 30_000, 8, 2, bytes(1000)))
    before = peak_memory_mb()
    for read in (photo_size, read_photo, check_photo):
        with pytest.raises(DataError, match=r"small\.png: says that its \d+ bytes hold 2575 MB"):
            read(path)
    assert peak_memory_mb() - before < 100


def test_a_png_whose_rows_are_not_there(tmp_path):
    path = tmp_path / "tall.png"
    path.write_bytes(png(16, 1_000_000, 8, 3, bytes(200)))  # Pillow gives it black, in a second
    with pytest.raises(DataError, match=r"tall\.png: says that its \d+ bytes hold 15 MB"):
        read_photo(path)


def rows_of(count: int, width: int, depth: int, channels: int, value: int = 7) -> bytes:
    """Rows of a PNG without a filter, all of one value."""
    return (b"\0" + bytes([value]) * ((width * depth * channels + 7) // 8)) * count


@pytest.mark.parametrize(
    ("depth", "colours", "channels"),
    [(8, 2, 3), (8, 0, 1), (1, 0, 1), (2, 3, 1), (16, 2, 3), (8, 6, 4)],
)
@pytest.mark.parametrize("short", [1, 5])
def test_a_png_that_is_a_few_rows_short(tmp_path, depth, colours, channels, short):
    """Pillow and OpenCV leave the missing rows black."""
    path = tmp_path / "short.png"
    path.write_bytes(png(41, 60, depth, colours, rows_of(60 - short, 41, depth, channels)))
    for read in (check_photo, read_photo, lambda at: read_photo(at, (1.0, 1.0, 1.0))):
        with pytest.raises(DataError, match=r"short\.png: its last rows are missing; replace"):
            read(path)


def test_a_png_whose_last_row_is_black_is_read(tmp_path):
    path = tmp_path / "dark.png"
    for mode in ("1", "L", "P", "RGB"):
        Image.new(mode, (41, 60)).save(path)
        assert float(read_photo(path).max()) == 0.0
    path.write_bytes(png(41, 60, 8, 2, rows_of(60, 41, 8, 3, value=0)))
    assert float(read_photo(path).max()) == 0.0


@pytest.mark.parametrize("short", [0, 1])
def test_an_interlaced_png_needs_all_of_its_passes(tmp_path, short):
    path, passes = tmp_path / "woven.png", [(1, 1), (1, 1), (2, 1), (2, 2), (4, 2), (4, 4), (8, 4)]
    rows = b"".join(rows_of(high, wide, 8, 1) for wide, high in passes)
    path.write_bytes(png(8, 8, 8, 0, rows[: len(rows) - 9 * short], interlaced=1))
    if short:
        with pytest.raises(DataError, match=r"woven\.png: its last rows are missing"):
            read_photo(path)
    else:
        assert float(read_photo(path).min()) == pytest.approx(7 / 255)


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "LA", "RGBA"])
def test_a_png_that_packs_as_well_as_any_is_read(tmp_path, mode):
    path = tmp_path / "flat.png"
    Image.new(mode, (4000, 3000)).save(path, optimize=True)
    assert photo_size(path) == (4000, 3000)


def test_a_jpeg_whose_blocks_are_not_there(tmp_path):
    path = tmp_path / "tall.jpg"
    Image.new("L", (65_000, 8)).save(path, quality=30)
    data = path.read_bytes()
    frame = data.index(b"\xff\xc0") + 5  # height and width of the frame header
    path.write_bytes(data[:frame] + struct.pack(">H", 255) + data[frame + 2 :])
    with pytest.raises(
        DataError, match=r"tall\.jpg: \d+ bytes are too few for a JPEG of 65000 x 255"
    ):
        read_photo(path)


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_a_jpeg_that_packs_as_well_as_any_is_read(tmp_path, mode, progressive):
    path = tmp_path / "flat.jpg"
    flat = Image.new(mode, (2000, 1500))
    flat.save(path, quality=1, optimize=True, progressive=progressive, subsampling=2)
    assert photo_size(path) == (2000, 1500)


def test_a_photo_that_the_memory_does_not_hold(tmp_path, monkeypatch):
    path = tmp_path / "large.png"
    Image.new("RGB", (2000, 1000)).save(path)
    read_photo(path)
    monkeypatch.setattr(memory, "available_mb", lambda: 60.0)
    assert photo_size(path) == (2000, 1000)
    for read in (read_photo, check_photo):
        with pytest.raises(MissingError, match=r"large\.png: takes 61 MB to read, more than 90%"):
            read(path)


def test_a_jpeg_that_the_memory_does_not_hold_is_not_ingested(tmp_path, monkeypatch):
    for name in ("a.jpg", "b.jpg"):
        Image.new("RGB", (2000, 1000)).save(tmp_path / name)
    monkeypatch.setattr(memory, "available_mb", lambda: 60.0)  # an eighth of the size would fit
    with pytest.raises(MissingError, match=r"a\.jpg: takes 61 MB to read, more than 90%"):
        survey_photos(tmp_path, lambda done, total: None)


def tiff_16(path: Path) -> None:
    cv2.imwrite(str(path), np.full((3, 4, 3), 700, np.uint16))


def png_16_transparent(path: Path) -> None:
    cv2.imwrite(str(path), np.full((3, 4, 4), 700, np.uint16))


def grey_and_alpha_16(path: Path) -> None:
    path.write_bytes(png(4, 3, 16, 4, (b"\0" + b"\x02\x01\xff\xff" * 4) * 3))


def in_mode(mode: str):
    def write(path: Path) -> None:
        Image.new(mode, (4, 3)).save(path)

    return write


@pytest.mark.parametrize(
    ("write", "name", "found"),
    [
        (tiff_16, "a.tif", "RGB of 16 bits"),
        (png_16_transparent, "a.png", "RGBA of 16 bits"),
        (grey_and_alpha_16, "a.png", "(LA|RGBA) of 16 bits"),
        (in_mode("CMYK"), "a.jpg", "CMYK,"),
        (in_mode("CMYK"), "a.tif", "CMYK,"),
        (in_mode("LAB"), "a.tif", "LAB,"),
        (in_mode("F"), "a.tif", "F of 32 bits"),
        (in_mode("I;16"), "a.png", "I;16 of 16 bits"),
    ],
)
def test_formats_that_would_lose_bits_or_colours_are_refused(tmp_path, write, name, found):
    write(tmp_path / name)
    for read in (read_photo, check_photo, lambda path: read_photo(path, (1.0, 1.0, 1.0))):
        with pytest.raises(
            DataError, match=rf"pixel format is {found}.* expected 8-bit RGB or grey"
        ):
            read(tmp_path / name)


def test_formats_of_8_bits_and_16_bit_rgb_are_read_as_stored(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (3, 4, 3)).astype(np.uint8)
    for name in ("a.png", "a.tif"):
        Image.fromarray(pixels).save(tmp_path / name)
        assert torch.equal(read_photo(tmp_path / name) * 255, torch.from_numpy(pixels).float())
    Image.fromarray(pixels[..., 0] > 99).save(tmp_path / "bits.png")
    assert read_photo(tmp_path / "bits.png").unique().tolist() == [0, 1]
    cv2.imwrite(str(tmp_path / "b.png"), pixels.astype(np.uint16)[..., ::-1] * 257)
    assert torch.equal(read_photo(tmp_path / "b.png"), read_photo(tmp_path / "a.png"))


@pytest.mark.parametrize("turned", [1, 2, 6])
def test_a_tiff_that_would_be_turned_while_it_is_read_is_refused(tmp_path, turned):
    """Pillow turns it and COLMAP does not: a model's pixels would be others'."""
    pixels = np.random.default_rng(0).integers(0, 256, (8, 12, 3), dtype=np.uint8)
    path, exif = tmp_path / "a.tif", Image.Exif()
    exif[ExifTags.Base.Orientation] = turned
    Image.fromarray(pixels).save(path, exif=exif)
    if turned == 1:
        assert np.array_equal((read_photo(path) * 255).round().numpy(), pixels)
        return
    for read in (read_photo, check_photo):
        with pytest.raises(DataError, match=f"its orientation is {turned}, .*save it upright"):
            read(path)


def test_damaged_16_bit_png(tmp_path):
    path = tmp_path / "b.png"
    cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 2**16, (30, 40, 3), np.uint16))
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    for at in rng.integers(8, len(whole), 40):
        broken = bytearray(whole)
        broken[at] ^= 0xFF
        path.write_bytes(broken)
        try:
            assert read_photo(path).shape == (30, 40, 3)
        except DataError as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017
    for size in range(0, len(whole), 997):
        path.write_bytes(whole[:size])
        with pytest.raises(DataError, match="not a readable image"):
            read_photo(path)


def test_photos_that_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "folder.png").mkdir()
    for name, kind in (("pipe.png", "a pipe"), ("folder.png", "a folder")):
        for read in (photo_size, read_photo, check_photo):
            with pytest.raises(DataError, match=f"{name}: is {kind}, expected a file"):
                read(tmp_path / name)
