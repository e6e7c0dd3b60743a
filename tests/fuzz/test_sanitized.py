"""The native layer under sanitizers, and the pool alone under the one for threads."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.sanitized import KINDS, RACE, ROOT

pytestmark = pytest.mark.slow
POOL = ROOT / "methods" / "kernels" / "csrc"


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
@pytest.mark.parametrize("shared", [False, True], ids=["as it is", "a planted race"])
def test_threads_of_the_pool_do_not_race(tmp_path, shared):
    source = Path(__file__).with_name("pool_alone.cpp")
    program, kind = tmp_path / "pool_alone", KINDS["threads"]
    subprocess.run(
        ["g++", "-std=c++17", *kind.flags.split(), f"-I{POOL}", source, POOL / "pool.cpp", "-o", program,
         "-pthread"], check=True,
    )  # fmt: skip
    done = subprocess.run(
        [program, *(["shared"] if shared else [])], env=kind.options, text=True, check=False,
        capture_output=True,
    )  # fmt: skip
    assert done.returncode == (RACE if shared else 0), done.stderr[:2000]
    assert ("data race" in done.stderr) == shared


@pytest.mark.skipif(
    shutil.which("cmake") is None or importlib.util.find_spec("nanobind") is None,
    reason="needs cmake and nanobind; `make fuzz` installs them",
)
@pytest.mark.parametrize("kind", KINDS)
def test_no_kernel_is_reported_by_a_sanitizer(kind):
    """Minutes of building at the first time; `make fuzz` runs it for longer."""
    done = subprocess.run(
        [sys.executable, ROOT / "tests/fuzz/sanitized.py", "--kind", kind, "--seconds", "60"], text=True,
        check=False, capture_output=True,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stderr[-3000:]}"
    found = re.search(r"(\d+) cases, (\d+) refused", done.stdout)
    assert found, done.stdout[-500:]
    assert int(found[1]) > 100
