"""What every command shares: help, exit codes, one-line errors, where output goes."""

import gc
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from splatproof import __version__, cli, start
from splatproof.base.errors import DataError, MissingError
from splatproof.base.plugin_files import forget_plugin_file, load_plugin_file
from splatproof.cli import COMMANDS, main, output
from splatproof.cli.flags import and_plugins
from splatproof.methods.registry import METHODS

BENCH = str(Path(sys.executable).with_name("bench"))


def test_help_names_every_command_with_its_line(capsys):
    assert main(["--help"]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for name, command in COMMANDS.items():
        assert f"{name} {command.help}" in text


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_is_joined_and_explains_itself(name, capsys):
    assert main([name, "--help"]) == 0
    assert f"usage: bench {name}" in capsys.readouterr().out


def test_version_is_that_of_the_package_and_the_checkout(capsys, monkeypatch):
    monkeypatch.setattr("splatproof.suites.environment.git_commit", lambda: "0123abc-dirty")
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"splatproof {__version__}, commit 0123abc-dirty\n"
    monkeypatch.setattr("splatproof.suites.environment.git_commit", lambda: "")
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"splatproof {__version__}\n"


def test_bench_alone_shows_what_there_is(capsys):
    assert main([]) == 2
    said = capsys.readouterr()
    text = " ".join(said.err.replace("│", " ").split())
    assert said.out == ""
    for name, command in COMMANDS.items():
        assert f"{name} {command.help}" in text


WITH_RESULTS = [
    "run", "score", "report", "doctor", "plan", "published", "render", "export", "gallery", "ingest",
    "fit 3dgs", "study stability", "scenes list", "scenes show", "scenes get", "scenes make",
]  # fmt: skip


@pytest.mark.parametrize("name", WITH_RESULTS)
def test_help_tells_the_keys_of_json(name, capsys):
    assert main([*name.split(), "--help"]) == 0
    assert "With --json" in " ".join(capsys.readouterr().out.split())


def test_help_of_a_group_has_a_line_for_each_and_help_of_one_tells_all(capsys):
    assert main(["fit", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for method in METHODS.values():
        assert f"{method.name} {method.description}." in text
    assert "continues a run that was interrupted" not in text
    assert main(["fit", "stitchgs", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert METHODS["stitchgs"].description in text
    assert "continues a run that was interrupted" in text


def test_help_starts_fast_and_imports_nothing_heavy():
    program = (
        "import sys; from splatproof.cli import main; main(['--help']);"
        "sys.exit(any(name in sys.modules for name in ('torch', 'mlflow', 'pycolmap', 'cv2')))"
    )
    before = os.times().children_user
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    assert os.times().children_user - before < 1.5  # CPU seconds: the machine may be busy


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["runn"],
        ["run"],
        ["run", "quick", "--sedes", "3"],
        ["run", "quick", "--seeds", "many"],
        ["run", "quick", "extra"],
        ["scenes"],
        ["scenes", "lst"],
        ["doctor", "--out"],
        ["export", "model"],
    ],
    ids=" ".join,
)
def test_usage_errors_exit_2_and_leave_stdout_alone(arguments, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err


def command_that(action):
    """A command in place of `doctor`."""

    def doctor() -> int:
        return action()

    return doctor


def raising(error: BaseException):
    def action() -> int:
        raise error

    return action


@pytest.fixture
def doctor(monkeypatch):
    from splatproof.cli import doctor as module

    def install(action) -> None:
        monkeypatch.setattr(module, "doctor", command_that(action))

    return install


@pytest.mark.parametrize(
    ("error", "code"), [(DataError("a.ply: found\n  3"), 2), (MissingError("no disk"), 3)]
)
def test_errors_that_a_user_can_mend_are_one_line(doctor, capsys, monkeypatch, error, code):
    doctor(raising(error))
    assert main(["doctor"]) == code
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"bench: {' '.join(str(error).split())}\n"
    monkeypatch.setenv("SPLATPROOF_DEBUG", "1")
    assert main(["doctor"]) == code
    assert "Traceback" in capsys.readouterr().err


def test_our_own_faults_are_not_hidden(doctor):
    doctor(raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        main(["doctor"])


def test_an_interrupt_is_told_in_one_line(doctor, capsys):
    doctor(raising(KeyboardInterrupt()))
    assert main(["doctor"]) == 130
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_results_go_to_stdout_logs_to_stderr_and_quiet_silences_logs(doctor, capsys):
    def action() -> int:
        output.log("on the way")
        output.emit({"psnr": float("nan"), "ssim": 0.5}, "psnr undefined")
        return 0

    doctor(action)
    assert main(["doctor"]) == 0
    assert capsys.readouterr() == ("psnr undefined\n", "on the way\n")
    assert main(["doctor", "--json", "--quiet"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out) == {"psnr": None, "ssim": 0.5}
    assert said.err == ""


def test_a_reader_that_leaves_is_no_error():
    program = (
        "import sys; from splatproof import cli\n"
        "from splatproof.cli import doctor, output\n"
        "def many(): [output.print_text('x' * 100) for _ in range(20000)]\n"
        "doctor.doctor = many; sys.exit(cli.main(['doctor']))"
    )
    shell = f'"{sys.executable}" -c "{program}" | head -n 1'
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, check=True)
    assert done.stdout == "x" * 100 + "\n"
    assert done.stderr == ""


def test_the_console_script_is_this_main():
    done = subprocess.run([BENCH, "nonsense"], capture_output=True, check=False)
    assert done.returncode == 2
    assert done.stdout == b""


def test_garbage_is_collected_once_a_command_begins(doctor, monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *_: None)  # the tests keep theirs
    monkeypatch.setattr(sys, "argv", ["bench", "doctor"])
    while_loading = []
    monkeypatch.setattr(cli, "_join", watched(cli._join, while_loading))
    doctor(lambda: int(not gc.isenabled()))
    try:
        assert start.main() == 0
        assert while_loading == [False]
    finally:
        gc.unfreeze()
        gc.enable()


def watched(function, seen: list[bool]):
    """The function, which notes first whether garbage is collected."""

    def noting(*given):
        seen.append(gc.isenabled())
        return function(*given)

    return noting


def test_exit_code_is_what_the_command_returns(doctor):
    doctor(lambda: 1)
    assert cli.main(["doctor"]) == 1
    doctor(lambda: None)
    assert cli.main(["doctor"]) == 0


@pytest.mark.parametrize(("typed", "meant"), [("3dg", "3dgs"), ("scafold-gs", "scaffold-gs")])
def test_a_method_that_is_nearly_one_is_named(typed, meant, capsys):
    assert main(["fit", typed, "courtyard", "--out", "x"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert repr(typed) in line
    assert repr(meant) in line


def test_outside_a_terminal_progress_is_a_line_now_and_then(capsys, monkeypatch):
    clock = iter([0.0, 4.0, 11.0, 11.0, 12.0, 30.0, 30.0])
    monkeypatch.setattr(output.time, "monotonic", lambda: next(clock))
    with output.progress() as bar:
        task = bar.add_task("town train", total=100, values="")
        for step in (10, 20, 30, 40):
            bar.update(task, completed=step, values=f"loss 0.{step}")
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[:4] for line in lines] == [
        ["town", "train", "20/100", "loss"], ["town", "train", "40/100", "loss"],
    ]  # fmt: skip


def test_quiet_means_no_lines_of_progress_either(capsys, monkeypatch):
    monkeypatch.setattr(output, "LINE_SECONDS", 0.0)
    with output.speaking(output.Style(quiet=True)), output.progress() as bar:
        bar.update(bar.add_task("x", total=2, values=""), completed=1)
    assert capsys.readouterr().err == ""


def test_a_printed_command_names_the_plugins_that_it_needs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my rigs").mkdir()
    paths = [tmp_path / "a_rig_of_mine.py", tmp_path / "my rigs" / "another_rig_of_mine.py"]
    for path in paths:
        path.write_text("")
    assert and_plugins() == ""
    loaded = [load_plugin_file(path) for path in paths]
    try:
        assert (
            and_plugins() == " --plugin a_rig_of_mine.py --plugin 'my rigs/another_rig_of_mine.py'"
        )
    finally:
        for file in loaded:
            forget_plugin_file(file)
