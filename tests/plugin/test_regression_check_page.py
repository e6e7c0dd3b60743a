"""docs/regression_check.md, followed to the letter in a folder and an environment of its own."""

import os
import re
import site
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

PAGE = Path(__file__).parents[2] / "docs" / "regression_check.md"
BLOCK = re.compile(
    r"(?:\*\*`(?P<file>[^`]+)`\*\*\n\n)?```(?P<kind>\w+)\n(?P<text>.*?)```", re.DOTALL
)
INSTALLED = "pip install ./splatproof pytest"
"""The only command that is not run: both are installed where the tests run."""
FAILS = "# exit code 1"


def blocks() -> list[tuple[str, str, str]]:
    """File name ("" where the page names none), language and text of every block, in order."""
    found = [(m["file"] or "", m["kind"], m["text"]) for m in BLOCK.finditer(PAGE.read_text())]
    assert len(found) == PAGE.read_text().count("```") / 2
    return found


def commands() -> list[str]:
    return [line for _, kind, text in blocks() if kind == "sh" for line in text.splitlines()]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A virtual environment with all that is installed here; what it installs stays in it."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    (own,) = folder.glob("lib/python*/site-packages")
    (own / "here.pth").write_text(
        "".join(f"import site; site.addsitedir({path!r})\n" for path in site.getsitepackages())
    )
    modules = {
        "pip": "pip", "pytest": "pytest",
        "bench": "-c 'from splatproof.cli import main; main()'",
    }  # fmt: skip
    for name, module in modules.items():
        script = folder / "bin" / name
        called = module if module.startswith("-c") else f"-m {module}"
        script.write_text(f'#!/bin/sh\nexec {folder}/bin/python {called} "$@"\n')
        script.chmod(0o755)
    offline = {"PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1", "PIP_NO_BUILD_ISOLATION": "0"}
    return os.environ | offline | {
        "PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONSAFEPATH": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1",
    }  # fmt: skip


@pytest.mark.slow  # six cases of 7 s of CPU each, most of it geometry scores, and eight starts of python
def test_every_command_of_the_page_does_what_it_says(tmp_path: Path, environment: dict[str, str]):
    failed = []
    for file, kind, text in blocks():
        if file:
            (tmp_path / file).write_text(text)
        for line in text.splitlines() if kind == "sh" else []:
            if line == INSTALLED:
                continue
            done = subprocess.run(
                ["sh", "-c", line], cwd=tmp_path, env=environment, capture_output=True, text=True,
                check=False, timeout=600,
            )  # fmt: skip
            assert done.returncode == int(FAILS in line), f"{line}\n{done.stdout}\n{done.stderr}"
            if FAILS in line:
                failed.append(done.stdout)
    (red,) = failed
    assert "worse than baselines/mine.json" in red
    assert "mine.splat/courtyard/my-splats/quick  psnr" in red
    assert "worst views:" in red
    assert (tmp_path / "baselines" / "mine.json").stat().st_size < 50_000
    assert "my-splats" in (tmp_path / "leaderboard.md").read_text()


def test_what_ci_runs_is_what_the_page_has_tried():
    (job,) = (yaml.safe_load(text) for _, kind, text in blocks() if kind == "yaml")
    ran = [step["run"] for step in job["jobs"]["quality"]["steps"] if "run" in step]
    shown = [line for line in ran if not line.startswith("cat ")]
    assert set(shown) <= set(commands())
    assert len(shown) == 4


def test_every_file_of_the_page_is_named():
    assert [file for file, kind, _ in blocks() if kind in ("python", "toml")] == [
        "my_splats.py", "pyproject.toml", "mine.splat.toml", "test_quality.py",
    ]  # fmt: skip
