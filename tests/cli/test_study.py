"""Studies from the command line: rows, table, file, exit code."""

import json
import re
from collections.abc import Iterator

import pytest

from splatproof.cli import main
from splatproof.cli.study import kept_rows
from splatproof.suites.studies import study


@pytest.fixture
def tiny(monkeypatch):
    """A study of two rows; the second one fails unless quick."""

    def rows(*, quick: bool) -> Iterator[dict]:
        yield {"case": "needle", "error": 1e-7, "note": "", "ok": True}
        yield {"case": "disc", "error": float("nan"), "note": "", "ok": quick}

    made = study.Study(description="tiny", columns=("case", "error", "note", "ok"), rows=rows)
    monkeypatch.setitem(study.STUDIES, "tiny", made)


def test_rows_are_printed_and_kept(tiny, tmp_path, capsys):
    assert main(["study", "tiny", "--quick", "--out", str(tmp_path), "--json", "--quiet"]) == 0
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["case"] for row in printed] == ["needle", "disc"]
    assert printed[1]["error"] is None
    kept = [json.loads(line) for line in (tmp_path / "tiny.jsonl").read_text().splitlines()]
    assert kept == printed


def test_a_row_over_its_budget_fails_the_command(tiny, tmp_path, capsys):
    assert main(["study", "tiny", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert [line.split() for line in out.splitlines()] == [
        ["case", "error", "ok"], ["needle", "1e-07", "yes"], ["disc", "nan", "NO"],
    ]  # fmt: skip
    assert "over its budget" in err


def test_an_interrupted_study_keeps_its_rows_and_says_so(monkeypatch, tmp_path, capsys):
    def rows(*, quick: bool) -> Iterator[dict]:
        yield {"case": "needle", "error": 1e-7, "ok": True}
        raise KeyboardInterrupt

    made = study.Study(description="cut", columns=("case", "error"), rows=rows)
    monkeypatch.setitem(study.STUDIES, "cut", made)
    assert main(["study", "cut", "--out", str(tmp_path)]) == 130
    assert json.loads((tmp_path / "cut.jsonl").read_text())["case"] == "needle"
    told = " ".join(capsys.readouterr().err.split())
    assert "1 rows are kept" in told
    assert "continues" not in told


def flags(text: str) -> set[str]:
    return set(re.findall(r"(?<!\S)--[a-z]+(?!\S)", text))


@pytest.mark.parametrize("name", study.STUDIES)
def test_a_study_shows_what_it_obeys_and_nothing_else(name, capsys):
    assert main(["study", name, "--help"]) == 0
    shown = flags(capsys.readouterr().out)
    obeyed = {f"--{option}" for option in study.STUDIES[name].options}
    if study.STUDIES[name].page:
        obeyed |= {"--page", "--rows"}
    assert shown - {"--help"} == {"--out", "--quick", "--json", "--quiet"} | obeyed


def test_an_option_of_another_study_is_refused(tmp_path, capsys):
    assert main(["study", "memory", "--wait", "7", "--out", str(tmp_path)]) == 2
    assert "--wait" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_rows_without_a_page_are_refused(tmp_path, capsys):
    rows = ["--rows", str(tmp_path / "rows.json")]
    for more in ([], ["--page", str(tmp_path / "page.md"), "--quick"]):
        assert main(["study", "speed", *rows, *more]) == 2
        assert "--rows makes a page again" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_page_of_some_cases_is_refused(tmp_path, capsys):
    assert main(["study", "speed", "--only", "adam", "--page", str(tmp_path / "page.md")]) == 2
    assert "without --only" in capsys.readouterr().err


def test_a_study_that_was_stopped_goes_on_after_the_last_whole_case(monkeypatch, tmp_path, capsys):
    asked, failing = [], [True]

    def rows(*, quick: bool, only: str | None, kept: list[dict]) -> Iterator[dict]:
        asked.append((only, [row["case"] for row in kept]))
        yield from kept
        for case in ("1", "1", "2", "2", "3"):
            if case not in {row["case"] for row in kept}:
                if case == "3" and failing.pop():
                    raise KeyboardInterrupt
                yield {"component": "x", "case": case, "ok": True}

    made = study.Study(
        description="resumed",
        columns=("case",),
        rows=rows,
        options=frozenset({"only"}),
        resumes=True,
    )
    monkeypatch.setitem(study.STUDIES, "resumed", made)
    words = ["study", "resumed", "--out", str(tmp_path)]
    assert main(words) == 130
    assert "the same command goes on" in capsys.readouterr().err
    failing.append(False)
    assert main(words) == 0
    # of the last case nobody knows whether it is whole
    assert asked == [(None, []), (None, ["1", "1"])]
    lines = (tmp_path / "resumed.jsonl").read_text().splitlines()
    assert [json.loads(line)["case"] for line in lines] == ["1", "1", "2", "2", "3"]
    failing.append(False)
    assert main(words) == 0
    assert asked[-1] == (None, []), "a study that came to its end is measured anew"


def test_a_stopped_study_that_is_stopped_again_at_once_loses_nothing(monkeypatch, tmp_path):
    def rows(*, quick: bool, kept: list[dict]) -> Iterator[dict]:
        if not kept:
            yield {"component": "x", "case": "1"}
            yield {"component": "x", "case": "2"}
        raise KeyboardInterrupt

    made = study.Study(description="stopped", columns=("case",), rows=rows, resumes=True)
    monkeypatch.setitem(study.STUDIES, "stopped", made)
    words = ["study", "stopped", "--out", str(tmp_path)]
    assert main(words) == 130
    before = (tmp_path / "stopped.jsonl").read_text()
    assert main(words) == 130
    assert (tmp_path / "stopped.jsonl").read_text() == before


@pytest.mark.parametrize("text", ["{", "[1]\n", "{}\n", "null\n"])
def test_rows_that_others_wrote_into_start_the_study_over(tmp_path, text):
    begun, file = tmp_path / "a.begun.json", tmp_path / "a.jsonl"
    begun.write_text("{}")
    file.write_text(text)
    assert kept_rows(begun, file, {}) == []
    begun.write_text("{")
    assert kept_rows(begun, file, {}) == []


@pytest.mark.parametrize("more", [["--only", "x/*"], ["--quick"]])
def test_other_words_start_over(monkeypatch, tmp_path, more):
    asked = []

    def rows(*, quick: bool, only: str | None, kept: list[dict]) -> Iterator[dict]:
        asked.append(len(kept))
        yield {"component": "x", "case": "1"}
        yield {"component": "x", "case": "2"}
        raise KeyboardInterrupt

    made = study.Study(
        description="stopped",
        columns=("case",),
        rows=rows,
        options=frozenset({"only"}),
        resumes=True,
    )
    monkeypatch.setitem(study.STUDIES, "stopped", made)
    words = ["study", "stopped", "--out", str(tmp_path)]
    for line in (words, words, [*words, *more]):
        assert main(line) == 130
    assert asked == [0, 1, 0]


def test_a_page_is_written_with_its_rows_and_made_again_from_them(monkeypatch, tmp_path, capsys):
    asked = []

    def rows(*, quick: bool, wait: float) -> Iterator[dict]:
        asked.append((quick, wait))
        yield {"case": "a", "error": 1.23456789e-7, "worst": float("inf"), "ok": True}

    def pictures(rows, folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "p.png").write_text(rows[0]["case"])
        return [folder / "p.png"]

    def page(machine, rows, pictures):
        return f"{min(machine)} {rows[0]['error']} {rows[0]['worst']} {list(pictures)}"

    made = study.Study(
        description="paged", columns=("case",), rows=rows, options=frozenset({"wait"}),
        pictures=pictures, page=page,
    )  # fmt: skip
    monkeypatch.setitem(study.STUDIES, "paged", made)
    out, file = tmp_path / "out", tmp_path / "docs" / "paged.md"
    arguments = ["study", "paged", "--wait", "7", "--page", str(file), "--out", str(out)]
    assert main(arguments) == 0
    assert asked == [(False, 7.0)]
    text = file.read_text()
    assert "1.23457e-07 None ['images/paged/p.png']" in text
    assert (file.parent / "images" / "paged" / "p.png").read_text() == "a"
    assert (out / "paged" / "p.png").exists()
    recorded = file.with_suffix(".json")
    before = recorded.read_text()
    file.unlink()
    again = ["study", "paged", "--rows", str(recorded), "--page", str(file), "--out", str(out)]
    assert main(again) == 0
    assert (file.read_text(), recorded.read_text()) == (text, before)
    assert len(asked) == 1  # nothing was measured
    assert "written:" in capsys.readouterr().err
