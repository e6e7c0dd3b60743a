"""Every planted fault must be seen by its component's tests (slow: one pytest run a fault)."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FAULTS = {
    path.stem: tomllib.loads(path.read_text())
    for path in sorted(Path(__file__).parent.glob("*.toml"))
}
CASES = [
    pytest.param(component["module"], component["tests"], fault, id=f"{name}-{i}")
    for name, component in FAULTS.items()
    for i, fault in enumerate(component["fault"])
]


def faulty(module: str, fault: dict[str, str]) -> str:
    """Source of a module with one fault planted; the place must be there exactly once."""
    source = (ROOT / module).read_text()
    assert source.count(fault["find"]) == 1, f"{module}: {fault['find']!r} is not there once"
    return source.replace(fault["find"], fault["replace"])


@pytest.mark.parametrize(("module", "tests", "fault"), CASES)
def test_every_fault_can_still_be_planted(module, tests, fault):
    """Fast guard: the list keeps up with the code."""
    assert faulty(module, fault) != (ROOT / module).read_text()
    assert all((ROOT / test).exists() for test in tests)


@pytest.mark.slow
@pytest.mark.parametrize(("module", "tests", "fault"), CASES)
def test_fault_is_seen(module, tests, fault, tmp_path):
    copy = tmp_path / Path(module).name
    copy.write_text(faulty(module, fault))
    name = "splatproof." + module.removesuffix(".py").replace("/", ".")
    # Without the type-checking import hook: it would load the module past ours, and the fault is
    # to be seen by the tests, not by the annotations.
    options = ["-x", "-q", "-o", "addopts=--import-mode=importlib", "-p", "helpers.mutant"]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *options, *tests],
        cwd=ROOT,
        env={**os.environ, "SPLATPROOF_MUTANT": f"{name}={copy}", "PYTHONPATH": "tests",
             "PYTHONSAFEPATH": "1"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )  # fmt: skip
    assert run.returncode == 1, f"{fault} was not seen:\n{run.stdout[-2000:]}{run.stderr[-500:]}"
