"""Photos that a camera stored lying are looked at standing."""

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from splatproof.datasets.ingesting.survey import survey_photos
from splatproof.datasets.ingesting.upright import copy_upright

TURNED = {  # what stands at an orientation is brought upright so (EXIF 2.3, tag 0x0112)
    1: lambda a: a, 2: lambda a: a[:, ::-1], 3: lambda a: a[::-1, ::-1], 4: lambda a: a[::-1],
    5: lambda a: a.transpose(1, 0, 2), 6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, 2).transpose(1, 0, 2), 8: lambda a: np.rot90(a),
}  # fmt: skip


def picture() -> np.ndarray:
    rng = np.random.Generator(np.random.PCG64(3))
    coarse = rng.uniform(20, 235, (6, 8, 3)).astype(np.float32)
    return (
        cv2.resize(coarse, (128, 96), interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8)
    )


def stored(path, orientation: int, **options) -> np.ndarray:
    """Write the picture with an orientation; its pixels as they are stored."""
    tags = Image.Exif()
    tags[ExifTags.Base.Make], tags[ExifTags.Base.Orientation] = "Made", orientation
    tags.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 27
    Image.fromarray(picture()).save(path, exif=tags, **options)
    with Image.open(path) as image:
        return np.asarray(image).astype(float)


def off(image: np.ndarray, expected: np.ndarray) -> float:
    return float(np.sqrt(((image - expected) ** 2).mean()))


@pytest.mark.parametrize("quality", [75, 92])
@pytest.mark.parametrize("orientation", TURNED)
def test_a_copy_is_as_the_photo_is_looked_at(tmp_path, orientation, quality):
    before = stored(tmp_path / "a.jpg", orientation, quality=quality)
    copy_upright(tmp_path / "a.jpg", tmp_path / "b.jpg")
    with Image.open(tmp_path / "b.jpg") as image:
        after, tags = np.asarray(image).astype(float), image.getexif()
    # colour is interpolated and halved once more; the worst of these is 0.92 of 255
    assert off(after, TURNED[orientation](before)) < 1.5
    assert tags.get(ExifTags.Base.Orientation, 1) == 1
    assert tags[ExifTags.Base.Make] == "Made"
    assert tags.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] == 27
    wrong = [turn(before) for other, turn in TURNED.items() if other != orientation]
    assert min(off(after, one) for one in wrong if one.shape == after.shape) > 15


@pytest.mark.parametrize("orientation", TURNED)
def test_a_photo_with_a_preview_behind_it_is_turned_too(tmp_path, orientation):
    preview = Image.fromarray(picture()).resize((32, 24))
    before = stored(
        tmp_path / "a.jpg", orientation, format="MPO", save_all=True, append_images=[preview],
        quality=92,
    )  # fmt: skip
    with Image.open(tmp_path / "a.jpg") as image:
        assert image.format == "MPO"
    copy_upright(tmp_path / "a.jpg", tmp_path / "b.jpg")
    with Image.open(tmp_path / "b.jpg") as image:
        assert off(np.asarray(image).astype(float), TURNED[orientation](before)) < 1.5
        assert image.getexif().get(ExifTags.Base.Orientation, 1) == 1


def test_what_lies_as_it_is_looked_at_is_copied_to_the_byte(tmp_path):
    for name, tag in (("a.jpg", 1), ("b.png", 6)):
        stored(tmp_path / name, tag)
        copy_upright(tmp_path / name, tmp_path / f"copy_{name}")
        assert (tmp_path / f"copy_{name}").read_bytes() == (tmp_path / name).read_bytes()


def test_a_grey_photo_is_turned_too(tmp_path):
    tags = Image.Exif()
    tags[ExifTags.Base.Orientation] = 8
    Image.fromarray(picture()[..., 0]).save(tmp_path / "a.jpg", exif=tags)
    copy_upright(tmp_path / "a.jpg", tmp_path / "b.jpg")
    with Image.open(tmp_path / "b.jpg") as image:
        assert (image.mode, image.size) == ("L", (96, 128))


def test_the_survey_knows_which_way_photos_are_looked_at(tmp_path):
    stored(tmp_path / "lying.jpg", 1)
    stored(tmp_path / "standing.jpg", 6)
    survey = survey_photos(tmp_path, lambda done, total: None)
    assert [photo.lens[:2] for photo in survey.photos] == [(128, 96), (96, 128)]
    assert [photo.turned for photo in survey.photos] == [False, True]
