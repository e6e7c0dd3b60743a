"""Readers of every kind of file stand damaged input; the fuzzer sees what it should see."""

import tomllib
from pathlib import Path

import pytest

from fuzz import inputs, planted
from fuzz.reading import Reader
from fuzz.serving import made_targets
from fuzz.target import CORPUS, slug
from fuzz.targets import TARGETS

INPUTS = 20_000
"""Of the million of `make fuzz-inputs`: its first numbers."""
FEWEST = 45
"""Inputs of a reader where only some are tried, unless one costs so much that all are fewer: of the photos' EXIF
data, which few damages reach, number 39 is the first that is refused."""


def some_of(goals: dict[str, int]) -> dict[str, int]:
    """A twentieth."""
    return {name: max(goal // 20, min(goal, FEWEST)) for name, goal in goals.items()}


@pytest.mark.parametrize("chosen", [some_of, pytest.param(dict, marks=pytest.mark.slow)])
def test_every_reader_stands_damaged_files(tmp_path, chosen):
    counts = inputs.read(tmp_path)
    goals = chosen(inputs.goals(INPUTS, []))
    inputs.run(counts, goals, tmp_path)
    table = inputs.table(counts)
    assert not any(count.faults for count in counts.values()), table
    # neither all refused nor all taken: what lies behind the first check is tried too
    tame = [name for name, count in counts.items() if not 0 < count.accepted < count.done]
    assert tame == [], table


def test_inputs_that_once_failed_have_their_reasons():
    reasons = tomllib.loads((CORPUS / "reasons.toml").read_text())
    kept = {f"{path.parent.name}/{path.name}" for path in CORPUS.glob("*/*")}
    assert kept == set(reasons)
    assert {path.parent.name for path in CORPUS.glob("*/*")} <= {slug(name) for name in TARGETS}


def test_an_input_is_made_from_its_name_and_number(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    some = {name: TARGETS[name] for name in ("scene.toml", "glb", "tar")}
    one, two = made_targets(tmp_path / "a", some), made_targets(tmp_path / "b", some)
    for name in some:
        first = [one[name].input(name, number) for number in range(60)]
        assert first == [two[name].input(name, number) for number in range(60)]
        assert len(set(first)) > 40


FAULTS = {
    "raises": "ValueError: invalid literal", "long": "took more than 1 s", "large": "MiB for", "huge": "MemoryError",
    "nan": "not finite: value.a.1", "nameless": "does not name the file", "lines": "not one line",
    "dies": "ends the process with code -6", "hangs": "hangs for 8 s", "sound": "", "late": "",
}  # fmt: skip


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    program = Path(planted.__file__)
    # wall time within which a busy machine gives a reader its one second of processor time
    with Reader(tmp_path_factory.mktemp("planted"), program, hangs=8) as reader:
        yield reader


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_seen(reader, name):
    found = reader.read(name, 0, 2)
    assert found.done == 2
    if FAULTS[name]:
        assert list(found.faults) == [1]
        assert FAULTS[name] in found.faults[1]
    else:
        assert found.faults == {}


def test_a_run_that_was_ended_goes_on(tmp_path):
    counts = inputs.read(tmp_path)
    counts["glb"].done = counts["glb"].accepted = 5
    inputs.write(counts, tmp_path)
    again = inputs.read(tmp_path)
    assert again == counts
    inputs.run(again, {"glb": 5}, tmp_path)  # nothing is left to do, so nothing is started
    assert again["glb"].done == 5
