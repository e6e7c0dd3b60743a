"""Marks: models kept after so many seconds, scored as they were, without disturbing what trains."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import fit, prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites.marks import FOLDER, Marks, seconds_to, timed_metrics, timed_scores
from splatproof.suites.suite_files import load_suite

SHORT = Settings(iterations=40, sh_degree=1)
PROTOCOL = replace(load_protocol("default"), metrics=("psnr",))


def some_model():
    return prepare(tiny_scene(), SHORT, Run(threads=1))[0]


def test_a_model_is_kept_at_each_mark_and_scored_as_it_was(tmp_path):
    scene = tiny_scene()
    marks = (1e-9, 1e6)
    fitted = fit(scene, SHORT, Run(threads=1, on_model=Marks(tmp_path, marks, 0.0)))
    assert [path.name for path in (tmp_path / FOLDER).iterdir()] == ["1e-09.pickle"]
    timed = timed_scores(tmp_path, marks, scene, PROTOCOL, "cpu", {"psnr": 50.0, "other": 1.0})
    (early, first), (late, last) = timed
    assert 0 < early < late == 1e6
    assert last == {"psnr": 50.0}, "training was over: the final model's"
    assert 5 < first["psnr"] < 50
    assert not (tmp_path / FOLDER).exists()
    undisturbed = fit(scene, SHORT, Run(threads=1))
    assert fitted.primitives == undisturbed.primitives


def test_what_writing_takes_is_not_counted(tmp_path, monkeypatch):
    """A slow disk must not make a method look slow; by a clock that nothing else moves."""
    clock = SimpleNamespace(now=0.0)

    def written(value: object) -> bytes:
        clock.now += 0.3
        return b"x"

    monkeypatch.setattr("splatproof.suites.marks.time.perf_counter", lambda: clock.now)
    monkeypatch.setattr("splatproof.suites.marks.pickled", written)
    marks = Marks(tmp_path, (0.1, 0.25), 0.0)
    clock.now += 0.12
    marks(10, 20, some_model())
    clock.now += 0.12
    marks(20, 20, some_model())
    assert sorted(path.name for path in (tmp_path / FOLDER).iterdir()) == ["0.1.pickle"]


def test_a_continued_case_keeps_what_it_has(tmp_path):
    marks = Marks(tmp_path, (5.0, 20.0), 10.0)
    marks(10, 20, some_model())
    assert [path.name for path in (tmp_path / FOLDER).iterdir()] == ["5.pickle"]
    before = (tmp_path / FOLDER / "5.pickle").read_bytes()
    Marks(tmp_path, (5.0, 20.0), 30.0)(12, 20, some_model())
    assert (tmp_path / FOLDER / "5.pickle").read_bytes() == before
    assert (tmp_path / FOLDER / "20.pickle").exists()


def test_seconds_to_a_share_of_the_gain():
    timed = tuple((t, {"psnr": value}) for t, value in ((0.0, 10.0), (10.0, 20.0), (20.0, 30.0)))
    assert seconds_to(timed, 0.75) == pytest.approx(15)
    dip = (*timed, (30.0, {"psnr": 20.0}), (40.0, {"psnr": 30.0}))
    assert seconds_to(dip, 0.75) == pytest.approx(35), "reached for good"
    assert seconds_to(timed[:1]) == 0
    assert math.isnan(seconds_to(((1.0, {}), (2.0, {}))))
    assert timed_metrics((10.0, 30.0), timed[:2]).keys() == {
        "psnr_10s",
        "psnr_30s",
        "time_to_95",
    }


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ('marks = [10, 5]\nmethods = ["3dgs"]', "marks: expected seconds above 0, rising"),
        ('marks = [0]\nmethods = ["3dgs"]', "marks: expected seconds above 0, rising"),
        ('marks = [5]\nmethods = ["citygaussian"]', "marks: citygaussian trains blocks"),
    ],
)
def test_marks_that_cannot_be_are_refused(tmp_path, line, error):
    path = tmp_path / "some.toml"
    path.write_text(
        f'description = "x"\n[[cases]]\nscenes = ["courtyard"]\nprotocols = ["default"]\n{line}\n'
    )
    with pytest.raises(UsageError, match=error):
        load_suite(path)
