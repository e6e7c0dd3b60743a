"""The page of the strangers' trial: made of its record, honest about what it leaves out."""

import numpy as np
import pytest
import trial_photos
from first_model_page import Record, Step, Trial, page, shortened, total
from PIL import ExifTags
from run_first_model import DOCS, PAGE, PICTURES, WORDS, Shell, read_record

from splatproof.datasets.ingesting.survey import gps_position

STEP = Step(command="bench fit", seconds=12.4, lines=("a  1/9", "a  9/9  0:00:02 left", "done"))
RECORD = Record(
    machine="two cores", setup=(Step(command="make setup", seconds=100.0, lines=()),),
    trials=(Trial(name="yard", photos="24 photos", steps=(STEP, STEP), pictures=("yard_model.jpg",)),),
)  # fmt: skip


def test_rows_of_progress_become_their_last_line_and_nothing_else_goes():
    lines = [
        "start",
        "a  1/9",
        "a  5/9  0:00:10 left",
        "a  9/9",
        "b  1/2",
        "done",
        "1/2 of it is said",
    ]
    assert shortened(lines) == [
        "start", "[3 lines of progress]", "b  1/2", "done", "1/2 of it is said",
    ]  # fmt: skip
    assert shortened(["a", "b"]) == ["a", "b"]
    assert shortened([]) == []


def test_a_page_shows_every_command_its_seconds_and_its_pictures():
    text = page(RECORD, "words")
    assert text.startswith("words\n")
    assert total(RECORD, RECORD.trials[0]) == pytest.approx(124.8)
    assert "| yard | 24 photos | 3 | 25 s | 125 s |" in text
    assert text.count("$ bench fit\n[1 line of progress]\na  9/9  0:00:02 left\ndone\n[12 s]") == 2
    assert "![yard: model](images/first_model/yard_model.jpg)" in text


def test_the_page_is_that_of_its_record():
    record = read_record()
    assert PAGE.read_text("utf-8") == page(record, (DOCS / "words" / WORDS).read_text("utf-8"))
    for trial in record.trials:
        assert len(record.setup) + len(trial.steps) <= 5
        assert all((PICTURES / one).stat().st_size > 10_000 for one in trial.pictures)


def test_a_shell_remembers_what_was_run_in_its_folder(tmp_path):
    first = Shell(tmp_path / "trial").run("echo here; pwd; echo $HOME")
    assert (first.lines[0], first.lines[-1]) == ("here", "/home")
    assert Shell(tmp_path / "trial").known("echo here; pwd; echo $HOME") == first
    with pytest.raises(RuntimeError, match="false ended with 1"):
        Shell(tmp_path / "trial").run("false")


@pytest.mark.parametrize("name", trial_photos.SETS)
def test_the_sets_bring_what_cameras_write_and_no_more(name):
    _, photos = trial_photos.SETS[name]()
    assert len({photo.name for photo in photos}) == len(photos) >= 20
    for photo in photos:
        tags = trial_photos.exif(photo)
        details = tags.get_ifd(ExifTags.IFD.Exif)
        assert details[ExifTags.Base.FocalLengthIn35mmFilm] == round(36 * photo.device.wide)
        assert (tags[ExifTags.Base.Orientation] == 6) is (photo.camera.height > photo.camera.width)
        found = gps_position(tags.get_ifd(ExifTags.IFD.GPSInfo))
        assert (found is not None) is photo.device.located


def test_a_drones_position_is_where_it_was():
    _, photos = trial_photos.SETS["town"]()
    for photo in photos[::7]:
        found = gps_position(trial_photos.exif(photo).get_ifd(ExifTags.IFD.GPSInfo))
        assert found is not None
        north = (found[0] - trial_photos.HOME[0]) * trial_photos.METRES_A_DEGREE
        east = (found[1] - trial_photos.HOME[1]) * trial_photos.METRES_A_DEGREE
        east *= np.cos(np.radians(trial_photos.HOME[0]))
        place = [east, north, found[2] - trial_photos.HOME[2]]
        assert np.allclose(place, photo.camera.centre.numpy(), atol=1e-3)
