"""Time, camera and sky masks beside a COLMAP model."""

import pytest

from splatproof.base.errors import DataError
from splatproof.datasets.view_times import Moment, read_moments, write_moments

MOMENTS = {"b.png": Moment(time=0.1, sensor="left"), "a.png": Moment(time=0.0, sensor="front")}


def test_what_is_written_is_read(tmp_path):
    write_moments(tmp_path, MOMENTS)
    assert read_moments(tmp_path, ["a.png"]) == MOMENTS
    assert read_moments(tmp_path / "other", ["a.png"]) == {}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "not JSON"),
        ("[1]", r'no table by the names of photos; write {"<photo>": {"time"'),
        ('{"a.png": {"sensor": "s"}}', r"time of view 'a\.png' is None, expected a finite number"),
        ('{"a.png": {"time": "x", "sensor": "s"}}', r"time of view 'a\.png' is 'x', expected"),
        ('{"a.png": 7}', r"time of view 'a\.png' is None.*; write {"),
    ],
)
def test_a_damaged_table_is_named(tmp_path, text, told):
    (tmp_path / "views.json").write_text(text)
    with pytest.raises(DataError, match=rf"views\.json: {told}"):
        read_moments(tmp_path, ["a.png"])


@pytest.mark.parametrize(
    "text", ['{"a.png": {"time": 1}}', '{"a.png": {"time": 1, "sensor": null}}']
)
def test_a_sensor_may_be_left_out(tmp_path, text):
    (tmp_path / "views.json").write_text(text)
    assert read_moments(tmp_path, ["a.png"]) == {"a.png": Moment(time=1.0, sensor="")}


def test_a_view_that_is_missing_is_named(tmp_path):
    write_moments(tmp_path, MOMENTS)
    with pytest.raises(DataError, match=r"c\.png"):
        read_moments(tmp_path, ["a.png", "c.png"])
