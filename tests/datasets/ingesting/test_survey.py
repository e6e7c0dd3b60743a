import math

import pytest
from PIL import ExifTags, Image

from helpers.aerial_photos import save_photo, texture
from splatproof.datasets.ingesting.survey import gps_position, survey_photos

TAGS = ExifTags.GPS


def tags(**changes) -> dict:
    found = {
        TAGS.GPSLatitudeRef: "N",
        TAGS.GPSLatitude: (46.0, 30.0, 36.0),
        TAGS.GPSLongitudeRef: "W",
        TAGS.GPSLongitude: (91.0, 15.0, 0.0),
        TAGS.GPSAltitudeRef: b"\0",
        TAGS.GPSAltitude: 198.5,
    }
    return found | {TAGS[name]: value for name, value in changes.items()}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, (46.51, -91.25, 198.5)),
        ({"GPSLatitudeRef": "S", "GPSLongitudeRef": "E"}, (-46.51, 91.25, 198.5)),
        ({"GPSAltitudeRef": b"\1"}, (46.51, -91.25, -198.5)),
        ({"GPSAltitudeRef": 1}, (46.51, -91.25, -198.5)),
    ],
)
def test_gps_position(changes, expected):
    assert gps_position(tags(**changes)) == pytest.approx(expected)


@pytest.mark.parametrize(
    "changes",
    [
        {"GPSLatitude": (math.nan, 0.0, 0.0)},
        {"GPSLatitude": (146.0, 0.0, 0.0)},
        {"GPSLatitude": (46.0, 0.0)},
        {"GPSLatitude": "46 N"},
        {"GPSLatitude": (0.0, 0.0, 0.0), "GPSLongitude": (0.0, 0.0, 0.0)},
    ],
)
def test_no_fix_is_no_position(changes):
    assert gps_position(tags(**changes)) is None
    assert gps_position({}) is None


def test_an_unknown_altitude_is_nan():
    without = tags()
    del without[TAGS.GPSAltitude]
    position = gps_position(without)
    assert position is not None
    assert math.isnan(position[2])


def test_sizes_makers_subfolders_and_blanks_in_names(tmp_path):
    pixels = texture(0, 60)
    save_photo(tmp_path / "b/two words.jpg", pixels, (10.0, 20.0, 30.0))
    save_photo(tmp_path / "a.JPG", pixels[:40])
    save_photo(tmp_path / ".hidden/c.jpg", pixels)
    told: list[tuple[int, int]] = []
    survey = survey_photos(tmp_path, lambda done, total: told.append((done, total)))
    assert [photo.name for photo in survey.photos] == ["a.JPG", "b/two_words.jpg"]
    assert [photo.lens for photo in survey.photos] == [
        (60, 40, "splatproof"),
        (60, 60, "splatproof"),
    ]
    assert len(survey.lenses) == 2
    assert survey.photos[0].gps is None
    assert survey.photos[1].gps == pytest.approx((46.00018, -90.99987, 330.0), abs=1e-4)
    assert told == [(0, 2), (1, 2), (2, 2)]


def test_photos_of_kinds_that_are_not_read_are_named(tmp_path):
    pixels = texture(0, 60)
    for name in ("a.jpg", "b.JPG", "e.tif"):
        save_photo(tmp_path / name, pixels)
    Image.fromarray(pixels).save(tmp_path / "d.webp")
    for name in ("c 1.HEIC", "c_1.HEIC", "f.dng", "deep/g.CR3", ".h.heic", "film.mov", "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"what only other programs read")
    survey = survey_photos(tmp_path, lambda done, total: None)
    assert [photo.name for photo in survey.photos] == ["a.jpg", "b.JPG", "e.tif"]
    assert {photo.lens for photo in survey.photos} == {(60, 60, "splatproof")}
    assert survey.unreadable == {
        name: f"{kind} is not read; convert it to JPEG or PNG"
        for name, kind in (
            ("c 1.HEIC", ".heic"),
            ("c_1.HEIC", ".heic"),
            ("d.webp", ".webp"),
            ("deep/g.CR3", ".cr3"),
            ("f.dng", ".dng"),
        )
    }


@pytest.mark.parametrize("turned", [3, 6])
def test_a_tiff_that_its_tag_turns_is_left_out(tmp_path, turned):
    """Pillow turns it, COLMAP does not: their pixels are not the same."""
    pixels = texture(0, 60)[:40]
    for name in ("a.tif", "b.tiff"):
        save_photo(tmp_path / name, pixels)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = turned
    Image.fromarray(pixels).save(tmp_path / "c.tif", exif=exif)
    survey = survey_photos(tmp_path, lambda done, total: None)
    assert [photo.name for photo in survey.photos] == ["a.tif", "b.tiff"]
    said = (
        f"its orientation is {turned}, which is obeyed in JPEGs alone; save it upright, or as JPEG"
    )
    assert survey.unreadable == {"c.tif": said}
