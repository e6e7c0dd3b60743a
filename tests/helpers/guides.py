"""Follows a page of docs: writes its files, runs its commands."""

import re
import runpy
import shlex
import subprocess
from pathlib import Path

import pytest

from splatproof.cli import main

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(
    r"(?:\*\*`(?P<file>[^`]+)`\*\*\n\n)?```(?P<kind>\w+)\n(?P<text>.*?)```", re.DOTALL
)
FAILS = re.compile(r"# exit code (\d)")


def blocks(page: str) -> list[tuple[str, str, str]]:
    """File name ("" where the page names none), language and text of every block, in order."""
    text = (DOCS / page).read_text()
    return [(m["file"] or "", m["kind"], m["text"]) for m in BLOCK.finditer(text)]


def commands(page: str) -> list[str]:
    return [line for _, kind, text in blocks(page) if kind == "sh" for line in text.splitlines()]


def follow(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch, *, only: str = "") -> None:
    """Do what the page says, in a folder; `bench` and `python` in this process.

    Args:
        page: Path below docs/.
        folder: Where files lie.
        monkeypatch: Changes the working folder.
        only: Commands of `bench run` and `bench report` without this option are left out.
    """
    monkeypatch.chdir(folder)
    for file, kind, text in blocks(page):
        if file:
            (folder / file).write_text(text)
        for line in text.splitlines() if kind == "sh" else []:
            if line.startswith(("bench run", "bench report")) and only not in line:
                continue
            expected = int(fails[1]) if (fails := FAILS.search(line)) else 0
            assert _run(line, folder) == expected, line


def _run(line: str, folder: Path) -> int:
    program, *arguments = shlex.split(line, comments=True)
    if program == "bench":
        return main(arguments)
    if program == "python":
        runpy.run_path(str(folder / arguments[0]), run_name="__main__")
        return 0
    return subprocess.run([program, *arguments], cwd=folder, check=False).returncode
