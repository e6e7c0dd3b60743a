"""The pytest plugin in a project of somebody else: what is worse must fail, and nothing else."""

import dataclasses
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from splatproof.methods.registry import METHODS
from splatproof.reference.types.result import BOOT
from splatproof.reports.comparing import baselines

CHECK = """
def test_mine(splatproof_run):
    splatproof_run("mine.splat.toml").not_worse(than="base.json", metrics=("psnr", "ssim_3dgs"))
"""
Change = Callable[[str, str], None]


@pytest.fixture(autouse=True)
def forget():
    """Methods of one project are not another's."""
    yield
    METHODS.pop("painted", None)


def records(project: pytest.Pytester) -> dict[str, int]:
    """When each record of the project was written."""
    found = (project.path / ".splatproof").rglob("record.json")
    return {str(path): path.stat().st_mtime_ns for path in found}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder for what the first `saved` project holds; the others get copies, which count as finished."""
    return tmp_path_factory.mktemp("kept")


@pytest.fixture
def saved(project: pytest.Pytester, kept: Path) -> pytest.Pytester:
    """The project with its test and a baseline that was saved by it."""
    project.makepyfile(test_mine=CHECK)
    if (kept / "base.json").exists():
        shutil.copytree(kept, project.path, dirs_exist_ok=True)
        return project
    result = project.runpytest_inprocess("--splatproof-save", "test_mine.py")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*splatproof*", "*frozen: 3 cases in*base.json"])
    shutil.copytree(project.path / ".splatproof", kept / ".splatproof")
    shutil.copy(project.path / "base.json", kept)
    return project


def test_unchanged_code_passes_and_nothing_runs_again(saved: pytest.Pytester):
    before = records(saved)
    assert len(before) == 3
    saved.runpytest_inprocess("test_mine.py").assert_outcomes(passed=1)
    assert records(saved) == before


ROWS = """
import pytest
@pytest.mark.parametrize("row", ["painted", "painted@loud"])
def test_row(splatproof_run, row):
    chosen = splatproof_run("rows.splat.toml", only=f"*/{row}/*")
    chosen.not_worse(than="base.json", metrics=("psnr",))
"""


@pytest.mark.slow  # fifteen cases
def test_tests_of_parts_of_a_suite_share_a_baseline(project: pytest.Pytester):
    suite = (project.path / "mine.splat.toml").read_text()
    both = suite.replace('["painted"]', '["painted", "painted@loud"]')
    both += '[cases.settings."painted@loud"]\nnoise = 0.02\n'
    (project.path / "rows.splat.toml").write_text(both)
    project.makepyfile(test_rows=ROWS)
    for _ in range(2):  # also where they are frozen again
        project.runpytest_inprocess("--splatproof-save", "test_rows.py").assert_outcomes(passed=2)
        kept = baselines.read(project.path / "base.json", "base.json").cases
        assert [case.measured.row for case in kept] == ["painted"] * 3 + ["painted@loud"] * 3
    strict = project.runpytest_inprocess("--splatproof-strict", "test_rows.py")
    strict.assert_outcomes(passed=2)


def test_a_method_made_worse_fails_with_what_got_worse_and_where(
    saved: pytest.Pytester, changed: Change
):
    changed("WRONG = 0.0", "WRONG = 5.0")
    result = saved.runpytest_inprocess("test_mine.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([
        "E*worse than base.json (holm over 2 tests, alpha 0.05):",
        "E*case *metric *before *now *change *interval *noise band *detectable",
        "E*mine.splat/scene/painted/half *psnr *-*[[]-*",
        "E*worst views:",
        "E*psnr of *.png: * -> * *seed0/{truth,renders,errors}/*.png",
    ])  # fmt: skip
    shown = next(line.split()[-1] for line in result.outlines if "psnr of" in line)
    assert Path(shown.replace("{truth,renders,errors}", "renders")).is_file()


def test_what_was_asked_for_and_is_not_judged_is_said(saved: pytest.Pytester):
    path = saved.path / "base.json"
    elsewhere = [
        dataclasses.replace(case, environment=case.environment | {BOOT: "another machine"})
        for case in baselines.read(path, "base.json").cases
    ]
    baselines.write(path, elsewhere)
    saved.makepyfile(test_mine=CHECK.replace('"ssim_3dgs"', '"render_ms"'))
    result = saved.runpytest_inprocess("test_mine.py")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*not judged against base.json:", "*render_ms: *"])
    saved.makepyfile(test_mine=CHECK.replace('"psnr", "ssim_3dgs"', '"render_ms",'))
    result = saved.runpytest_inprocess("test_mine.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*render_ms: *", "*nothing of this run could be compared*"])


def test_a_comment_in_the_code_runs_the_cases_again_and_passes(
    saved: pytest.Pytester, changed: Change
):
    before = records(saved)
    changed('"""Place them."""', '"""Place all of them."""')
    saved.runpytest_inprocess("test_mine.py").assert_outcomes(passed=1)
    assert len(records(saved)) == 2 * len(before)


def test_a_case_that_fails_is_named(saved: pytest.Pytester, changed: Change):
    changed("FAILS = False", "FAILS = True")
    result = saved.runpytest_inprocess("test_mine.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["E*CaseFailed: scene/painted/half/seed0: *not today*"])


def test_a_missing_or_damaged_baseline_says_what_to_do(saved: pytest.Pytester):
    (saved.path / "base.json").unlink()
    result = saved.runpytest_inprocess("test_mine.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*base.json: no such baseline; run pytest with --splatproof-save"])
    (saved.path / "base.json").write_text("{}")
    result = saved.runpytest_inprocess("test_mine.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*base.json: no baseline; *"])


def test_other_data_under_the_baseline_cannot_pass(saved: pytest.Pytester):
    protocol = saved.path / "half.toml"
    protocol.write_text(protocol.read_text().replace("hold = 2", "hold = 3"))
    result = saved.runpytest_inprocess("test_mine.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*other rules of the protocol: *", "*nothing of this run *"])


def test_undecided_is_shown_and_fails_where_that_is_asked_for(
    saved: pytest.Pytester, changed: Change
):
    changed("+ WRONG", "+ 0.3 * (run.seed - 1)")  # lighter, the same and darker
    result = saved.runpytest_inprocess("test_mine.py")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*= splatproof =*", "*undecided against base.json:*"])
    saved.runpytest_inprocess("test_mine.py", "--splatproof-strict").assert_outcomes(failed=1)


def test_a_suite_file_is_collected_case_by_case(project: pytest.Pytester):
    result = project.runpytest_inprocess("-v", "mine.splat.toml")
    result.assert_outcomes(passed=3)
    result.stdout.fnmatch_lines(["mine.splat.toml::scene/painted/half/seed0 PASSED*"])
    options = ["mine.splat.toml", "--splatproof-baseline", "base.json"]
    project.runpytest_inprocess(*options, "--splatproof-save").assert_outcomes(passed=4)
    project.runpytest_inprocess(*options).assert_outcomes(passed=4)


def test_a_suite_file_fails_by_the_cases_error_and_is_checked(
    saved: pytest.Pytester, changed: Change
):
    options = ["mine.splat.toml", "--splatproof-baseline", "base.json"]
    changed("WRONG = 0.0", "WRONG = 5.0")
    result = saved.runpytest_inprocess(*options)
    result.assert_outcomes(passed=3, failed=1)
    result.stdout.fnmatch_lines(["worse than base.json*"])
    changed("FAILS = False", "FAILS = True")
    result = saved.runpytest_inprocess("mine.splat.toml")
    result.assert_outcomes(failed=3)
    result.stdout.fnmatch_lines(["scene/painted/half/seed0: *not today*"])


def test_a_wrong_suite_file_is_one_line(project: pytest.Pytester):
    (project.path / "wrong.splat.toml").write_text('description = "?"\n[[cases]]\nscenes = 1\n')
    result = project.runpytest_inprocess("wrong.splat.toml")
    result.assert_outcomes(errors=1)
    assert not any("Traceback" in line for line in result.outlines)
    result.stdout.fnmatch_lines(["*wrong.splat.toml: cases*scenes*"])


def test_absent_scenes_skip_with_the_reason(
    project: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("SPLATPROOF_DATA", str(project.path))
    suite = (project.path / "mine.splat.toml").read_text()
    (project.path / "far.splat.toml").write_text(suite.replace("./scene", "brighton_beach"))
    project.makepyfile(
        test_far="""
        import pytest

        @pytest.mark.needs_scene("brighton_beach")
        def test_marked():
            raise AssertionError

        @pytest.mark.needs_scene("courtyard")
        def test_made():
            pass

        def test_run(splatproof_run):
            splatproof_run("far.splat.toml")

        @pytest.mark.needs_scene("brighton_beech")
        def test_misspelt():
            pass
        """
    )
    result = project.runpytest_inprocess("-rs", "test_far.py", "far.splat.toml")
    result.assert_outcomes(skipped=5, passed=1, errors=1)
    result.stdout.fnmatch_lines(["*SKIPPED*brighton_beach: not on this machine; looked for *"])
    result.stdout.fnmatch_lines(["*did you mean*brighton_beach*"])


@pytest.mark.slow  # five runs
def test_a_baseline_holds_several_suites(saved: pytest.Pytester):
    other = (saved.path / "mine.splat.toml").read_text()
    (saved.path / "other.splat.toml").write_text(other.replace("[0, 1, 2]", "[3, 4]"))
    options = ["other.splat.toml", "--splatproof-baseline", "base.json"]
    result = saved.runpytest_inprocess(*options)
    result.stdout.fnmatch_lines(["*base.json: no case, so there is nothing to compare"])
    saved.runpytest_inprocess(*options, "--splatproof-save").assert_outcomes(passed=3)
    saved.runpytest_inprocess(*options).assert_outcomes(passed=3)
    saved.runpytest_inprocess("test_mine.py", "--splatproof-strict").assert_outcomes(passed=1)


@pytest.mark.slow  # three starts of python, each with all imports
def test_processes_of_xdist_run_each_case_once(project: pytest.Pytester):
    """Two workers ask for the same suite at once; both pass, and each record is written once."""
    text = CHECK.replace("def test_mine", "def test_{}")
    project.makepyfile(test_a=text.replace("{}", "a"), test_b=text.replace("{}", "b"))
    project.runpytest_inprocess("--splatproof-save", "test_a.py").assert_outcomes(passed=1)
    before = records(project)
    done = project.runpytest_subprocess("-n", "2", "-p", "xdist", "test_a.py", "test_b.py")
    done.assert_outcomes(passed=2)
    assert records(project) == before


def test_nothing_of_splatproof_or_torch_is_loaded_before_it_is_used(project: pytest.Pytester):
    program = (
        "import sys, pytest; pytest.main(['--co', '-q', sys.argv[1]]); "
        "print(sorted({'splatproof', 'torch'} & set(sys.modules)))"
    )
    (project.path / "conftest.py").unlink()
    (project.path / "mine.splat.toml").unlink()
    file = project.makepyfile("def test_mine(splatproof_run): pass")
    done = subprocess.run(
        [sys.executable, "-c", program, str(file)], capture_output=True, text=True, check=True,
        cwd=project.path,
    )  # fmt: skip
    assert "1 test collected" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"
