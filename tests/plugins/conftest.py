"""The example package of a third party, installed in a folder of its own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that pip installed it into; it is not on this process's path."""
    place = tmp_path_factory.mktemp("plugins")
    source = place / "source"  # building leaves files beside the sources
    source.mkdir()
    shutil.copy(HERE / "pyproject.toml", source)
    shutil.copytree(HERE / "splatproof_example", source / "splatproof_example")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
    options = ["--no-build-isolation", "--target", str(place / "site"), str(source)]
    subprocess.run([*command, *options], check=True, capture_output=True, text=True)
    return place / "site"


@pytest.fixture(scope="session")
def environment(site: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Of processes that see the installed package."""
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    cache = tmp_path_factory.mktemp("cache")
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths), "SPLATPROOF_CACHE": str(cache)}
