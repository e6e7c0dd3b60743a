"""What reading photos takes, part by part, of all threads together."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest

from helpers.colmap_scenes import MODELS, Flight, write_scene
from splatproof.datasets import truth_image
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.reading_clock import PARTS, READING, ReadingClock
from splatproof.reference.types.protocol import Protocol


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still unless it is moved."""
    found = SimpleNamespace(now=0.0)
    monkeypatch.setattr("splatproof.datasets.reading_clock.time.perf_counter", lambda: found.now)
    return found


def test_seconds_of_all_threads_add_up_and_a_block_that_fails_is_not_counted():
    counted = ReadingClock()

    def read(_: int) -> None:
        with counted.timed("decode"):
            pass

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(read, range(100)))
    before = counted.seconds()
    assert before["decode"] > 0
    assert before["undistort"] == before["resize"] == 0
    with pytest.raises(ValueError, match="torn"), counted.timed("undistort"):
        raise ValueError("torn")
    assert counted.since(before) == dict.fromkeys(PARTS, 0.0)


@pytest.mark.parametrize(("model", "resizes", "bends"), [("OPENCV", 2, 1), ("PINHOLE", 1, 0)])
@pytest.mark.parametrize("small", [False, True])
def test_each_part_of_a_photo_is_counted_as_what_it_is(
    tmp_path, monkeypatch, clock, model, resizes, bends, small
):
    """Decoding takes a second by that clock, undistorting ten, resizing a hundred."""

    def slow(name: str, seconds: float) -> None:
        fast = getattr(truth_image, name)

        def run(*given):
            clock.now += seconds
            return fast(*given)

        monkeypatch.setattr(truth_image, name, run)

    write_scene(tmp_path / "yard", Flight(model=model, params=MODELS[model], views=2))
    scene = open_scene(str(tmp_path / "yard"), Protocol(name="test", source="test", hold=0))
    for name, seconds in (("read_photo", 1.0), ("undistort_image", 10.0), ("resample", 100.0)):
        slow(name, seconds)
    before = READING.seconds()
    load = scene.views[0].load
    assert isinstance(load, truth_image.Truth)
    _ = load.at((20, 15)) if small else load()
    expected = {"decode": 1.0, "undistort": 10.0 * bends, "resize": 100.0 * resizes}
    assert READING.since(before) == pytest.approx(expected)
