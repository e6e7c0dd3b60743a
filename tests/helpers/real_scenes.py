"""Real scenes for tests: found through SPLATPROOF_DATA, or the test is skipped with the reason."""

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


def data_roots() -> list[Path]:
    """Folders of SPLATPROOF_DATA (default: data and ../shared/data, beside the repository)."""
    value = os.environ.get("SPLATPROOF_DATA")
    folders = value.split(os.pathsep) if value else ["data", "../shared/data"]
    return [(REPOSITORY / folder).resolve() for folder in folders if folder]


def real_scene(name: str) -> Path:
    """Folder of a real scene such as "brighton_beach"; skips the calling test where it is absent."""
    for root in data_roots():
        if (root / name).is_dir():
            return root / name
    looked = ", ".join(str(root) for root in data_roots())
    pytest.skip(f"scene {name} not found in {looked}; set SPLATPROOF_DATA to the folder it is in")
