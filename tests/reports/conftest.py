"""One small suite in a store, shared by the tests of the page and of the command."""

import shutil
from pathlib import Path

import pytest

from helpers import case_folders
from splatproof.reports.mlflow_client import open_client
from splatproof.reports.store import StoredResult, read_results, sync


@pytest.fixture(scope="session")
def migrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty store whose tables exist: making them takes a second, copying them nothing."""
    file = tmp_path_factory.mktemp("empty") / "mlflow.db"
    open_client(f"sqlite:///{file}")
    return file


@pytest.fixture(scope="session")
def suite_folder(migrated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Case folders of two scenes, three methods and three seeds, in a store beside them."""
    out = tmp_path_factory.mktemp("suite")
    shutil.copy(migrated, out / "mlflow.db")
    assert sync(list(case_folders.suite(out)), f"sqlite:///{out}/mlflow.db") == []
    return out


@pytest.fixture(scope="session")
def stored(suite_folder: Path) -> list[StoredResult]:
    """What the store of `suite_folder` gives back."""
    return read_results(f"sqlite:///{suite_folder}/mlflow.db")
