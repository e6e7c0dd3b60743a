"""Suite files: the product of each table, and one-line errors that name file, key and nearest."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from helpers import fake_methods
from helpers.fake_methods import FakeSettings, fake_scene
from splatproof.base.errors import UsageError
from splatproof.methods.registry import METHODS
from splatproof.suites import run_case as cases
from splatproof.suites.case_keys import case_key
from splatproof.suites.suite_files import FOLDER, load_suite, quick_form, suite_names

GOOD = """
description = "For tests"
[[cases]]
scenes = ["town", "village"]
methods = ["fake"]
protocols = ["default", "quick"]
seeds = [0, 3]
[cases.settings.fake]
iterations = 7
inner.rate = 1
"""


@pytest.fixture(autouse=True)
def _fakes(monkeypatch):
    monkeypatch.setitem(METHODS, "fake", None)
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    fake_methods.register()


def written(folder: Path, text: str, name: str = "mine.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_cases_are_the_product_with_all_settings(tmp_path):
    suite = load_suite(written(tmp_path, GOOD))
    assert suite.name == "mine"
    assert suite.scenes == ("town", "village")
    assert len({case.label for case in suite.cases}) == len(suite.cases) == 8
    assert suite.cases[0].label == "town/fake/default/seed0"
    assert suite.cases[0].settings == FakeSettings(iterations=7, inner=fake_methods.Inner(rate=1.0))
    assert isinstance(suite.cases[0].settings.inner.rate, float)


def test_a_table_may_have_a_width_of_its_own(tmp_path):
    suite = load_suite(written(tmp_path, GOOD.replace("seeds", "width = 120\nseeds")))
    protocols = {case.protocol.name: case.protocol.width for case in suite.cases}
    assert protocols == {"default-120px": 120, "quick-120px": 120}


def test_a_folder_that_is_written_like_a_name_is_told_how_to_write_it(tmp_path, monkeypatch):
    (tmp_path / "mine" / "scene").mkdir(parents=True)
    (tmp_path / "here").mkdir()
    for name, meant in (("mine/scene", "'./mine/scene'"), ("here", "here'")):
        path = written(
            tmp_path / "mine" if name == "here" else tmp_path, GOOD.replace("town", name)
        )
        monkeypatch.chdir(tmp_path)
        with pytest.raises(
            UsageError, match=f"{name}' is a folder .* relative to the suite file.*{meant}"
        ):
            load_suite(path)


def test_two_variants_of_a_method_that_collide_are_told_about_the_at(tmp_path):
    table = GOOD[GOOD.index("[[cases]]") :]
    with pytest.raises(UsageError, match=r"\[cases\.settings\.\"fake@two\"\]"):
        load_suite(written(tmp_path, GOOD + table.replace("= 7", "= 9")))


def test_scene_folders_and_protocol_files_are_relative_to_the_suite_file(tmp_path):
    written(tmp_path, 'source = "ours"\nwidth = 64\n', "small.toml")
    text = GOOD.replace('"town"', '"./data/town"').replace('"quick"', '"./small.toml"')
    suite = load_suite(written(tmp_path, text))
    assert suite.cases[0].scene == str((tmp_path / "data/town").resolve())
    assert {case.protocol.name for case in suite.cases} == {"default", "small"}
    assert suite.cases[2].protocol.width == 64
    assert suite.cases[0].label == "town/fake/default/seed0"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_every_suite_that_ships_loads(path):
    assert load_suite(path.stem).cases


def test_the_key_depends_on_everything_that_a_number_depends_on(tmp_path):
    case = load_suite(written(tmp_path, GOOD)).cases[0]
    others = [
        replace(case, seed=1),
        replace(case, scene="x"),
        replace(case, method="x"),
        replace(case, settings=replace(case.settings, iterations=8)),
        replace(case, settings=replace(case.settings, inner=fake_methods.Inner(cap=3))),
        replace(case, protocol=replace(case.protocol, width=9)),
    ]
    keys = {case_key(other, "cpu") for other in [case, *others]} | {case_key(case, "cuda")}
    assert len(keys) == 8
    # A folder moved elsewhere is still the same scene.
    assert case_key(replace(case, scene="/data/town"), "cpu") == case_key(case, "cpu")


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


BAD = {
    "not a TOML file": (GOOD + "[[", "not a TOML file"),
    "empty": ("", "description is missing"),
    "no cases": ('description = "x"', "cases is missing"),
    "blocks, as cases were called once": (
        GOOD.replace("cases", "blocks"),
        r"unknown 'blocks'.* There are: cases, description",
    ),
    "unknown key": (
        changed("[[cases]]", "[[cases]]\nseed = [1]"),
        r"cases\[0\]: unknown 'seed', did you mean 'seeds'",
    ),
    "unknown top key": ('title = 1\ndescription = "x"\ncases = []', "unknown 'title'"),
    "unknown method": (
        changed('["fake"]', '["fkae"]'),
        r"cases\[0\].methods: unknown 'fkae', did you mean 'fake'",
    ),
    "unknown protocol": (changed('"quick"', '"qiuck"'), "unknown 'qiuck', did you mean 'quick'"),
    "unknown setting": (
        changed("iterations", "iteratons"),
        "settings.fake: unknown 'iteratons', did you mean 'iterations'",
    ),
    "unknown inner setting": (
        changed("inner.rate", "inner.rato"),
        "settings.fake.inner: unknown 'rato', did you mean 'rate'",
    ),
    "settings of no method here": (
        changed("settings.fake", "settings.fake2"),
        "settings: unknown 'fake2', did you mean 'fake'",
    ),
    "text for a number": (changed("iterations = 7", 'iterations = "7"'), "iterations: .*'7'"),
    "fraction for a whole number": (changed("iterations = 7", "iterations = 7.5"), "iterations: "),
    "truth for a number": (changed("inner.rate = 1", "inner.rate = true"), "inner.rate: .*True"),
    "value the method refuses": (
        changed("iterations = 7", "iterations = 0"),
        "iterations is 0, expected",
    ),
    "text for a list": (changed('["fake"]', '"fake"'), r"cases\[0\].methods: .*'fake'"),
    "no scene": (changed('["town", "village"]', "[]"), "scenes: empty"),
    "no seed": (changed("[0, 3]", "[]"), "seeds: empty"),
    "negative seed": (changed("[0, 3]", "[-1]"), "seeds: .*-1"),
    "no width": (changed("seeds = [0, 3]", "width = 0"), r"cases\[0\].width: .*1 or more, found 0"),
    "a seed twice": (
        changed("[0, 3]", "[3, 3]"),
        "the case town/fake/default/seed3 is there twice",
    ),
    "optional scene that is not there": (
        changed("description", 'optional_scenes = ["tonw"]\ndescription'),
        "optional_scenes: tonw is among the scenes of no table",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_named_in_one_line(tmp_path, name):
    text, message = BAD[name]
    path = written(tmp_path, text)
    with pytest.raises(UsageError, match=message) as error:
        load_suite(path)
    assert "\n" not in str(error.value)
    assert error.value.exit_code == 2
    if name != "unknown protocol":
        assert str(path) in str(error.value)


def test_a_missing_file_a_wrong_name_and_a_name_that_is_no_folder(tmp_path):
    with pytest.raises(UsageError, match="no such suite file"):
        load_suite(tmp_path / "none.toml")
    with pytest.raises(UsageError, match="unknown 'qick', did you mean 'quick'"):
        load_suite("qick")
    with pytest.raises(UsageError, match="the file's name becomes a folder"):
        load_suite(written(tmp_path, GOOD, "a b.toml"))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="not UTF-8 text"):
        load_suite(tmp_path / "binary.toml")


def test_shared_settings_and_variants(tmp_path):
    text = GOOD.replace('["fake"]', '["fake", "fake@long"]').replace(
        "seeds = [0, 3]", "shared = { iterations = 9, inner = { cap = 2 } }"
    )
    text += '[cases.settings."fake@long"]\niterations = 100\n'
    cases = load_suite(written(tmp_path, text)).cases
    plain, long = cases[0], cases[2]
    assert plain.settings == FakeSettings(iterations=7, inner=fake_methods.Inner(rate=1.0, cap=2))
    assert long.settings == replace(plain.settings, iterations=100)
    assert (plain.row, long.row) == ("fake", "fake@long")
    assert long.label == "town/fake@long/default/seed0"
    assert case_key(replace(long, settings=plain.settings), "cpu") == case_key(plain, "cpu")
    for wrong, message in (
        (text.replace("fake@long", "fake@a/b"), "'fake@a/b'; after '@' use letters"),
        (text.replace("fake@long", "fake@"), "'fake@'; after '@' use letters"),
        (
            text.replace('settings."fake@long"', 'settings."fake@lng"'),
            "unknown 'fake@lng', did you mean",
        ),
        (text.replace("{ iterations", "{ iteration"), "unknown 'iteration'"),
    ):
        with pytest.raises(UsageError, match=message):
            load_suite(written(tmp_path, wrong))


@pytest.mark.parametrize(
    "suite", [name for name in suite_names() if f"{name}-medium" in suite_names()]
)
def test_a_row_of_the_medium_form_differs_from_the_suites_in_its_length_alone(suite):
    def settings(name: str) -> dict[str, set[str]]:
        found: dict[str, set[str]] = {}
        for case in load_suite(name).cases:
            told = asdict(replace(case.settings, iterations=1))
            found.setdefault(case.row, set()).add(json.dumps(told, sort_keys=True))
        return found

    own, medium = settings(suite), settings(f"{suite}-medium")
    assert medium
    assert medium == {row: own[row] for row in medium}


def test_the_reduced_form_is_the_suite_beside_it():
    assert quick_form("city") == "city-quick"
    with pytest.raises(
        UsageError, match="suite 'brighton' has no reduced form; .* of anchors, city"
    ):
        quick_form("brighton")
